"""`ovmot doctor`."""

from pathlib import Path
from typing import Annotated

import typer

import ovmot
from ovmot.cli.console import EXIT_FAILED, NOTHING_WRITTEN, interruptible, progress, show
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    LeftOption,
    RightOption,
    SequenceOption,
)
from ovmot.doctor.examine import examine, sampled_frames
from ovmot.doctor.report import report_table, write_report


def doctor(
    data: Annotated[Path, typer.Argument(help="Folder of a recorded sequence, or a ROS bag.")],
    format: FormatOption = None,
    sequence: SequenceOption = None,
    calibration: CalibrationOption = None,
    left: LeftOption = None,
    right: RightOption = None,
    imu: ImuOption = None,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the findings as JSON as well.")
    ] = None,
) -> None:
    """Say what is wrong or doubtful in a sequence before it is run; exit code 1 if it is wrong."""
    ovmot.prepare_process()
    with interruptible(NOTHING_WRITTEN):
        recorded = ovmot.open(
            data,
            format,
            sequence,
            calibration,
            topics=ovmot.BagTopics(left, right, imu),
            need_pairs=False,
        )
    with (
        interruptible(NOTHING_WRITTEN),
        progress("doctor", sampled_frames(recorded)) as advance,
    ):
        report = examine(recorded, advance, calibration)
    show(report_table(report))
    if json is not None:
        write_report(json, report)
    if report.is_wrong:
        raise typer.Exit(EXIT_FAILED)
