"""`ovmot calibrate`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from ovmot.cli.console import NOTHING_WRITTEN, interruptible, printable, say, show
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    LeftOption,
    RightOption,
    SequenceOption,
    SetOption,
)
from ovmot.errors import InputError

if TYPE_CHECKING:
    from ovmot import RecordedSequence, Settings, WrittenCalibration

_RUN_JSON = "run.json"


def calibrate(
    data: Annotated[
        Path,
        typer.Argument(help="Folder of a recorded sequence, a ROS bag, or the folder of a run."),
    ],
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
    config: Annotated[
        Path | None, typer.Option(help="YAML of settings for the run that estimates.")
    ] = None,
    set_: SetOption = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Replace files that are there, and write what the checks refuse.",
        ),
    ] = False,
) -> None:
    """Write a calibration as a Kalibr chain, the IMU's noise as OpenVINS's file beside it.

    That which a run has estimated, with each value before and after; of a recorded sequence, one is
    run for that. What the motion does not show stays as it was. With --as-is, what the data has.
    """
    import ovmot
    from ovmot.cli.progress import progress
    from ovmot.cli.recorded import open_recorded
    from ovmot.run_calibration import refuse_existing_files

    if not as_is and (data / _RUN_JSON).is_file():
        _write_found(data, data, out, force)
        return
    topics, overrides = ovmot.BagTopics(left, right, imu), set_ or []
    given, recorded = open_recorded(data, format, sequence, calibration, topics, config, overrides)
    for warning in recorded.warnings:
        say(f"ovmot: warning: {warning}")
    if as_is:
        _say_written(data, ovmot.write_calibration(recorded, out, replace=force))
        return
    if not given.settings.calibration.any:
        more = [*overrides, "calibration.extrinsics=true"]
        given = ovmot.load_run_config(config, more, left, right)
    settings = recorded.settings(given.settings)
    if not force:  # before the work, not after it
        refuse_existing_files(out, recorded.imu is not None)
    ovmot.prepare_process()
    _refuse_mistakes(recorded, settings, force)
    with TemporaryDirectory() as folder:
        options = ovmot.RunOptions(folder, force=True)
        with interruptible(NOTHING_WRITTEN), progress("run", len(recorded)) as advance:
            ovmot.run_sequence(recorded, settings, options, advance)
        _write_found(data, Path(folder), out, force)


def _refuse_mistakes(recorded: "RecordedSequence", settings: "Settings", force: bool) -> None:
    """Raise `InputError` for a mistake that an estimate would hide: it corrects small errors."""
    from ovmot.cli.progress import progress
    from ovmot.doctor.examine import mistake_beyond_refinement, sampled_frames
    from ovmot.doctor.fix import fix_over, set_options

    with interruptible(NOTHING_WRITTEN), progress("check", sampled_frames(recorded)) as advance:
        found = mistake_beyond_refinement(recorded, settings, advance)
    if found is None:
        return
    fix = set_options(fix_over(found.fix, settings))
    _refuse(recorded.root, f"{found.says}; {found.remedy}{f' ({fix})' if fix else ''}", force)


def _refuse(source: Path, line: str, force: bool) -> None:
    """Raise `InputError`, or only warn."""
    if not force:
        raise InputError.at(source, line, "--force writes anyway")
    say(f"ovmot: warning: {line}")


def _write_found(data: Path, run: Path, out: Path, force: bool) -> None:
    from ovmot.run_calibration import calibration_table, run_calibration, write_run_calibration

    found = run_calibration(run)
    show(calibration_table(found))
    if found.doubt:
        remedy = "correct what ovmot doctor finds, or T_cam_imu; widen calibration.*_sigma if it is"
        _refuse(data, f"{found.doubt}; {remedy} no better known", force)
    _say_written(data, write_run_calibration(run, out, found, overwrite=force))


def _say_written(source: Path, written: "WrittenCalibration") -> None:
    for note in written.notes:
        say(f"ovmot: warning: {note}")
    typer.echo(printable(f"{source} -> {', '.join(map(str, written.files))}"))
