"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from ovmot import DATASETS

FormatOption = Annotated[
    str | None, typer.Option(help=f"Kind of data: {', '.join(DATASETS)}; else recognised.")
]
SequenceOption = Annotated[
    str | None, typer.Option(help="Which sequence, where the folder holds several.")
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(help="Kalibr chain or rig file of VINS, in place of the data's calibration."),
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
