"""`ovmot doctor`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ovmot.cli.console import EXIT_FAILED, NOTHING_WRITTEN, interruptible, printable, show
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    LeftOption,
    RightOption,
    SequenceOption,
    SetOption,
)

if TYPE_CHECKING:
    from ovmot import Settings
    from ovmot.doctor.report import Report


def doctor(
    data: Annotated[Path, typer.Argument(help="Folder of a recorded sequence, or a ROS bag.")],
    format: FormatOption = None,
    sequence: SequenceOption = None,
    calibration: CalibrationOption = None,
    left: LeftOption = None,
    right: RightOption = None,
    imu: ImuOption = None,
    config: Annotated[
        Path | None,
        typer.Option(help="YAML of settings as for a run; it overrules the format's preset."),
    ] = None,
    set_: SetOption = None,
    fix: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT", help="Write what is sure as a settings file for --config of a run."
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the findings as JSON as well.")
    ] = None,
) -> None:
    """Say what is wrong or doubtful in a sequence before it is run; exit code 1 if it is wrong."""
    import ovmot
    from ovmot.cli.progress import progress
    from ovmot.cli.recorded import open_recorded
    from ovmot.doctor.examine import examine, sampled_frames
    from ovmot.doctor.report import report_table, write_report

    ovmot.prepare_process()
    topics = ovmot.BagTopics(left, right, imu)
    given, recorded = open_recorded(
        data, format, sequence, calibration, topics, config, set_ or (), need_pairs=False
    )
    chain = calibration or given.calibration
    chain_file = chain if isinstance(chain, Path) else None
    with (
        interruptible(NOTHING_WRITTEN),
        progress("doctor", sampled_frames(recorded)) as advance,
    ):
        report = examine(recorded, advance, chain_file, given.settings)
    show(report_table(report))
    if json is not None:
        write_report(json, report)
    if fix is not None:
        _write_fix(fix, report, given.settings)
    if report.is_wrong:
        raise typer.Exit(EXIT_FAILED)


def _write_fix(path: Path, report: "Report", given: "Settings") -> None:
    from ovmot.doctor.fix import fixed_settings, write_settings

    sections = fixed_settings(report, given)
    if sections is None:
        typer.echo(printable(f"nothing that settings could mend: {path} is not written"))
        return
    write_settings(path, sections)
    typer.echo(printable(f"{path}: give it to the run by --config"))
