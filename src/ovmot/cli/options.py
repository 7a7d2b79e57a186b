"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from ovmot.cli.names import FORMATS, View


def _formats(incomplete: str) -> list[str]:
    return [name for name in FORMATS if name.startswith(incomplete)]


FormatOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"Kind of data: {', '.join(FORMATS)}; else recognised.",
        autocompletion=_formats,
    ),
]
SequenceOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which sequence, where the folder holds several.")
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        help="Kalibr chain, rig file of VINS, or a data set's folder, in place of the data's"
        " calibration."
    ),
]
LeftOption = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Topic of a bag's left camera, or its name in a Kalibr chain; else found.",
    ),
]
RightOption = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Topic of a bag's right camera, or its name in a Kalibr chain; else found.",
    ),
]
ImuOption = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's IMU; else found.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="SECTION.KEY=VALUE", help="One setting; repeatable."),
]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")
]
JsonLinesOption = Annotated[
    bool, typer.Option("--json-lines", help="Say progress and result as lines of JSON.")
]
ViewOption = Annotated[
    View,
    typer.Option(
        help="What overlays show: moving objects, the stereo check, the test of dynamic points."
    ),
]
RerunOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE.rrd|viewer",
        help="Record the run for Rerun's viewer, or show it there as it goes on.",
    ),
]
