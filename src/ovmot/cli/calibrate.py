"""`ovmot calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

import ovmot
from ovmot import InputError
from ovmot.cli.console import NOTHING_WRITTEN, interruptible, printable, say
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    LeftOption,
    RightOption,
    SequenceOption,
)


def calibrate(
    data: Annotated[Path, typer.Argument(help="Folder of a recorded sequence, or a ROS bag.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Kalibr chain to write: chain.yaml.")],
    as_is: Annotated[
        bool, typer.Option("--as-is", help="Write the calibration that the data has.")
    ] = False,
    format: FormatOption = None,
    sequence: SequenceOption = None,
    calibration: CalibrationOption = None,
    left: LeftOption = None,
    right: RightOption = None,
    imu: ImuOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Write a data set's calibration as a Kalibr chain, its IMU's noise as OpenVINS's file."""
    if not as_is:
        raise InputError("ovmot calibrate: give --as-is: it writes what the data has")
    with interruptible(NOTHING_WRITTEN):
        recorded = ovmot.open(
            data, format, sequence, calibration, topics=ovmot.BagTopics(left, right, imu)
        )
        written = ovmot.write_calibration(recorded, out, replace=force)
    for note in (*recorded.warnings, *written.notes):
        say(f"ovmot: warning: {note}")
    typer.echo(printable(f"{data} -> {', '.join(map(str, written.files))}"))
