"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from ovmot import DATASETS, PRESETS, View

FormatOption = Annotated[
    str | None, typer.Option(help=f"Kind of data: {', '.join(DATASETS)}; else recognised.")
]
SequenceOption = Annotated[
    str | None, typer.Option(help="Which sequence, where the folder holds several.")
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
    list[str] | None, typer.Option("--set", help="One setting: section.key=value; repeatable.")
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


def preset_lines() -> list[str]:
    """The presets in words, one line a format."""
    return [
        f"preset of {name}: {', '.join(f'{key}={value}' for key, value in preset.values.items())}"
        for name, preset in PRESETS.items()
    ]
