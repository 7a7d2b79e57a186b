"""The command line: thin; errors become one line and an exit code here alone.

What a command needs is imported in it: `ovmot --help` and shell completion load no library but
Typer.
"""

import io
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ovmot.cli.batch import batch
from ovmot.cli.calibrate import calibrate
from ovmot.cli.console import (
    EXIT_BAD_INPUT,
    EXIT_FAILED,
    NOTHING_WRITTEN,
    interruptible,
    say,
    say_warning,
    show,
)
from ovmot.cli.demo import demo
from ovmot.cli.doctor import doctor
from ovmot.cli.live import ros, ros2
from ovmot.cli.names import PRESET_FORMATS, SCENES, WRITER_FORMATS
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    JsonLinesOption,
    LeftOption,
    QuietOption,
    RerunOption,
    RightOption,
    SequenceOption,
    SetOption,
    ViewOption,
)
from ovmot.cli.report import report, report_of_run
from ovmot.cli.rerun import rerun_output
from ovmot.cli.settings import config, settings
from ovmot.cli.version import version_lines
from ovmot.cli.warmup import warmup
from ovmot.errors import InputError, OvmotError
from ovmot.runtime import take_signals_as_interrupts

if TYPE_CHECKING:
    from ovmot import Output, RecordedSequence, RunContext, View

app = typer.Typer(
    name="ovmot", no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None,
    help="Stereo-inertial odometry and moving-object tracks, without learned models.",
)  # fmt: skip


def main() -> None:
    """Run the command line; errors meant for the user become one line and an exit code.

    A polite request to end and a terminal that is closed are taken as Ctrl-C: what was done is
    kept, and said.
    """
    take_signals_as_interrupts()
    warnings.showwarning = say_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # the names of files need not be text
    try:
        app()
    except InputError as error:
        say(f"ovmot: {error}")
        sys.exit(EXIT_BAD_INPUT)
    except OvmotError as error:
        say(f"ovmot: {error}")
        sys.exit(EXIT_FAILED)
    except OSError as error:  # a folder that may not be read
        say(f"ovmot: {error}")
        sys.exit(EXIT_BAD_INPUT)
    except MemoryError:
        say("ovmot: out of memory: give a shorter or smaller sequence")
        sys.exit(EXIT_FAILED)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print versions and processor, and exit.")
    ] = False,
) -> None:
    if version:
        for line in version_lines():
            typer.echo(line)
        raise typer.Exit


@app.command(short_help="Run a recorded sequence.")
def run(
    data: Annotated[
        Path,
        typer.Argument(help="Folder of a recorded sequence, or a ROS bag: .bag, .mcap, .db3."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into.")],
    format: FormatOption = None,
    sequence: SequenceOption = None,
    calibration: CalibrationOption = None,
    left: LeftOption = None,
    right: RightOption = None,
    imu: ImuOption = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="YAML of settings that differ, or an estimator_config.yaml of OpenVINS; overrules"
            f" the format's preset ({', '.join(PRESET_FORMATS)}: see 'ovmot settings')."
        ),
    ] = None,
    set_: SetOption = None,
    ego: Annotated[
        tuple[str, Path] | None,
        typer.Option(
            metavar="poses FILE",
            help="Ego motion from a file (TUM, EuRoC or KITTI form), not the filter.",
        ),
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks: cam0.png, cam1.png, cam0/<ns>.png, ...")
    ] = None,
    save_points: Annotated[
        bool, typer.Option("--save-points", help="Write points.csv and stereo.csv.")
    ] = False,
    video: Annotated[bool, typer.Option("--video", help="Write overlay.mp4.")] = False,
    view: ViewOption = "objects",
    bag: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.bag",
            help="Write the results as a ROS bag too: .bag, .mcap, or a folder of ROS 2.",
        ),
    ] = None,
    rerun: RerunOption = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Make no report.html.")] = False,
    no_objects: Annotated[
        bool, typer.Option("--no-objects", help="Do not look for moving objects.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the run that the folder holds.")
    ] = False,
    first: Annotated[
        int, typer.Option(min=0, metavar="N", help="First frame, counted from 0.")
    ] = 0,
    last: Annotated[int | None, typer.Option(min=0, metavar="N", help="Last frame.")] = None,
    threads: Annotated[
        int,
        typer.Option(
            min=1, max=2, metavar="N", help="Threads of the odometry; the results are the same."
        ),
    ] = 2,
    quiet: QuietOption = False,
    json_lines: JsonLinesOption = False,
) -> None:
    """Run a recorded sequence and write trajectory, points, tracks and timing."""
    import ovmot
    from ovmot.cli.compiling import compiling
    from ovmot.cli.progress import HealthWatch, progress, say_result, style_of
    from ovmot.cli.recorded import open_recorded, repeated_options

    style = style_of(quiet, json_lines)
    overrides = [*(set_ or ()), *(["objects.enabled=false"] if no_objects else [])]
    with compiling(style) as wait_for_kernels:
        ovmot.prepare_process()
        topics = ovmot.BagTopics(left, right, imu)
        given, recorded = open_recorded(
            data, format, sequence, calibration, topics, config, overrides,
            need_imu_pose=ego is None,
        )  # fmt: skip
        settings = recorded.settings(given.settings)
        for warning in recorded.warnings:
            say(f"ovmot: warning: {warning}")
        watch = HealthWatch()
        more = [] if bag is None else [_bag_output(bag, recorded, view if video else None, force)]
        if rerun is not None:
            more.append(rerun_output(rerun, force))
        options = ovmot.RunOptions(
            out, _ego_poses(ego), save_points, video, force, first, last, masks, (watch, *more),
            given.mask_files, threads, view, preview=not no_report,
            doctor_options=repeated_options(
                format=format, sequence=sequence, calibration=calibration, left=left, right=right,
                imu=imu, config=config,
            ),
        )  # fmt: skip
        wait_for_kernels()
    said = set(recorded.warnings)

    def say_once(line: str) -> None:
        said.add(line)
        say(f"ovmot: {line}")

    stop = len(recorded) if last is None else min(last + 1, len(recorded))
    with (
        interruptible("what was done until here is written whole"),
        progress("run", max(stop - first, 0), style, watch) as advance,
    ):
        summary = ovmot.run_sequence(recorded, settings, options, advance, say_once)
    for warning, count in summary.warnings.items():
        if warning not in said:
            say(f"ovmot: warning: {warning} ({count})")
    if (other := watch.other_offset()) is not None:
        say(f"ovmot: {other}")
    written = summary.counts["frames_written"]
    objects = f", {watch.counted_objects()}" if summary.settings.objects.enabled else ""
    rate = written / max(summary.wall_seconds, 1e-9)
    took = f"{summary.wall_seconds:.1f} s ({rate:.1f} frames/s)"
    say_result(
        style, f"{written} frames{objects} in {took} -> {out}",
        frames=written, seconds=round(summary.wall_seconds, 3), out=str(out),
    )  # fmt: skip
    if not no_report:
        report_of_run(out, style)


@app.command(short_help="Render a street as a recorded sequence, with its truth.")
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write into: new or empty.")],
    scene: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help=f"A scene ({', '.join(SCENES)}) or a YAML file of one.",
            autocompletion=lambda incomplete: [n for n in SCENES if n.startswith(incomplete)],
        ),
    ] = "traffic",
    path: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="The rig's path: stand, walk, drive, or a TUM file; else the scene's own.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Another seed, another street.")
    ] = 0,
    format: Annotated[
        str, typer.Option(metavar="NAME", help=f"Layout: {', '.join(WRITER_FORMATS)}.")
    ] = "kaist",
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Image size; else the scene's.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Stereo frames a second; else the scene's.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Length; else the scene's.")
    ] = None,
    quiet: QuietOption = False,
    json_lines: JsonLinesOption = False,
) -> None:
    """Render a street as a recorded sequence, with the truth beside it."""
    import ovmot
    from ovmot.cli.progress import progress, say_result, style_of

    style = style_of(quiet, json_lines)
    if format not in WRITER_FORMATS:
        known = ", ".join(WRITER_FORMATS)
        raise InputError(f"--format {format}: unknown; choose one of {known}")
    ovmot.prepare_process()
    simulated = ovmot.simulate(
        scene, seed=seed, path=path, size=_size(size), rate_hz=rate, duration_s=duration
    )
    total = len(simulated)
    with (
        interruptible(f"{out} holds an unfinished sequence: delete it"),
        progress("simulate", total, style) as advance,
    ):
        simulated.write(out, format, advance)
    say_result(style, f"{total} frames -> {out}", frames=total, out=str(out))


@app.command(short_help="Hold a run against the truth.")
def evaluate(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth", help="Data with its truth, or a TUM file; else what the run has read."
        ),
    ] = None,
    sequence: SequenceOption = None,
    plots: Annotated[bool, typer.Option(help="Draw plots beside metrics.json.")] = True,
    everything: Annotated[
        bool, typer.Option("--all", help="Show every metric, not only the first ones.")
    ] = False,
) -> None:
    """Hold a run against the truth: a table, metrics.json and plots, written into the run."""
    import ovmot

    with interruptible(NOTHING_WRITTEN):
        evaluation = ovmot.evaluate(run, truth, sequence=sequence)
    ovmot.write_metrics(run, evaluation)
    if plots:
        ovmot.write_plots(run, evaluation)
    show(ovmot.metrics_table(evaluation, everything=everything))
    if not everything:
        say(f"every metric: {run / 'metrics.json'}, or --all")


app.command(short_help="Simulate, run and evaluate a small street.")(demo)
app.command(short_help="Run sequences x settings x seeds, and add up.")(batch)
app.command(short_help="Make a page of finished runs.")(report)
app.command(short_help="Say what is wrong or doubtful in a sequence.")(doctor)
app.command(short_help="Write a calibration as a Kalibr chain.")(calibrate)
app.command(short_help="Run live on ROS 1.")(ros)
app.command(short_help="Run live on ROS 2.")(ros2)
app.command(short_help="List the settings, or those with a text.")(settings)
app.command(short_help="Print the settings that a run would have as YAML.")(config)
app.command(short_help="Compile ahead what the first run compiles.")(warmup)


def _bag_output(
    path: Path, recorded: "RecordedSequence", view: "View | None", force: bool
) -> "Callable[[RunContext], Output]":
    from ovmot.ros.bag_output import BagOutput

    read, written = recorded.root.resolve(), path.resolve()
    if recorded.kind == "bag" and read in (written, *written.parents):
        raise InputError.at(path, "is the bag that is read", "choose another name with --bag")
    return lambda context: BagOutput(
        path, context.rig, overlay=view is not None, view=view or "objects", replace=force
    )


def _ego_poses(ego: tuple[str, Path] | None) -> Path | None:
    if ego is None:
        return None
    kind, path = ego
    if kind != "poses":
        raise InputError(f"--ego {kind}: unknown; write --ego poses FILE")
    return path


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size {text}: is no size; write WIDTHxHEIGHT, as in 640x280")
    return int(width), int(height)
