"""The command line: thin; errors become one line and an exit code here alone."""

import io
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

import ovmot
from ovmot import InputError, OvmotError, RecordedSequence, RunOptions
from ovmot.batch.batch import run_batch
from ovmot.batch.execute import DaskCluster, Executor, LocalProcesses
from ovmot.batch.plan import read_plan
from ovmot.batch.summary import summary_tables
from ovmot.batch.work import work
from ovmot.cli.calibrate import calibrate
from ovmot.cli.console import (
    EXIT_BAD_INPUT,
    EXIT_FAILED,
    NOTHING_WRITTEN,
    compile_where,
    interruptible,
    nothing_is_compiled,
    printable,
    progress,
    say,
    say_warning,
    show,
    stages,
)
from ovmot.cli.doctor import doctor
from ovmot.cli.live import ros, ros2
from ovmot.cli.options import (
    CalibrationOption,
    FormatOption,
    ImuOption,
    LeftOption,
    RightOption,
    SequenceOption,
    SetOption,
    preset_lines,
)
from ovmot.cli.recorded import open_recorded
from ovmot.ros.bag_output import BagOutput
from ovmot.runtime import take_signals_as_interrupts

app = typer.Typer(
    name="ovmot", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
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
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"ovmot {ovmot.__version__}")
        raise typer.Exit


@app.command(epilog="\n\n".join(preset_lines()))
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
            f" the format's preset ({', '.join(ovmot.PRESETS)}; see below)."
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
    bag: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.bag",
            help="Write the results as a ROS bag too: .bag, .mcap, or a folder of ROS 2.",
        ),
    ] = None,
    no_objects: Annotated[
        bool, typer.Option("--no-objects", help="Do not look for moving objects.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the run that the folder holds.")
    ] = False,
    first: Annotated[int, typer.Option(min=0, help="First frame, counted from 0.")] = 0,
    last: Annotated[int | None, typer.Option(min=0, help="Last frame.")] = None,
    threads: Annotated[
        int, typer.Option(min=1, max=2, help="Threads of the odometry; the results are the same.")
    ] = 2,
) -> None:
    """Run a recorded sequence and write trajectory, points, tracks and timing."""
    ovmot.prepare_process()
    first_use = nothing_is_compiled()
    overrides = [*(set_ or ()), *(["objects.enabled=false"] if no_objects else [])]
    topics = ovmot.BagTopics(left, right, imu)
    given, recorded = open_recorded(
        data, format, sequence, calibration, topics, config, overrides, need_imu_pose=ego is None
    )
    settings = recorded.settings(given.settings)
    for warning in recorded.warnings:
        say(f"ovmot: warning: {warning}")
    more = () if bag is None else (_bag_output(bag, recorded, video, force),)
    options = RunOptions(
        out, _ego_poses(ego), save_points, video, force, first, last, masks, more,
        given.mask_files, threads,
    )  # fmt: skip
    said = set(recorded.warnings)

    def say_once(line: str) -> None:
        said.add(line)
        say(f"ovmot: {line}")

    stop = len(recorded) if last is None else min(last + 1, len(recorded))
    with interruptible(NOTHING_WRITTEN):
        compile_where(first_use)
    with (
        interruptible("what was done until here is written whole"),
        progress("run", max(stop - first, 0)) as advance,
    ):
        summary = ovmot.run_sequence(recorded, settings, options, advance, say_once)
    for warning, count in summary.warnings.items():
        if warning not in said:
            say(f"ovmot: warning: {warning} ({count})")
    written = summary.counts["frames_written"]
    rate = written / max(summary.wall_seconds, 1e-9)
    took = f"{summary.wall_seconds:.1f} s ({rate:.1f} frames/s)"
    typer.echo(printable(f"{written} frames in {took} -> {out}"))


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write into: new or empty.")],
    scene: Annotated[
        str, typer.Option(help=f"A scene ({', '.join(ovmot.SCENES)}) or a YAML file of one.")
    ] = "traffic",
    path: Annotated[
        str | None,
        typer.Option(
            help="The rig's path: stand, walk, drive, or a TUM file; else the scene's own."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another street.")] = 0,
    format: Annotated[str, typer.Option(help=f"Layout: {', '.join(ovmot.WRITERS)}.")] = "kaist",
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Image size; else the scene's.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Stereo frames a second; else the scene's.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Length; else the scene's.")
    ] = None,
) -> None:
    """Render a street as a recorded sequence, with the truth beside it."""
    ovmot.prepare_process()
    if format not in ovmot.WRITERS:
        known = ", ".join(ovmot.WRITERS)
        raise InputError(f"--format {format}: unknown; choose one of {known}")
    simulated = ovmot.simulate(
        scene, seed=seed, path=path, size=_size(size), rate_hz=rate, duration_s=duration
    )
    total = len(simulated)
    with (
        interruptible(f"{out} holds an unfinished sequence: delete it"),
        progress("simulate", total) as advance,
    ):
        simulated.write(out, format, advance)
    typer.echo(printable(f"{total} frames -> {out}"))


@app.command()
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
    with interruptible(NOTHING_WRITTEN):
        evaluation = ovmot.evaluate(run, truth, sequence=sequence)
    ovmot.write_metrics(run, evaluation)
    if plots:
        ovmot.write_plots(run, evaluation)
    show(ovmot.metrics_table(evaluation, everything=everything))
    if not everything:
        say(f"every metric: {run / 'metrics.json'}, or --all")


@app.command()
def batch(
    plan: Annotated[Path, typer.Argument(help="YAML file: sequences, settings, seeds.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into, or to go on in.")],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Local processes; else one a core.")
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, in place of local processes."),
    ] = None,
    retries: Annotated[
        int, typer.Option(min=0, help="How often a run whose worker died is tried again.")
    ] = 2,
    monte_carlo: Annotated[
        int | None, typer.Option(min=2, metavar="N", help="Seeds 0 to N-1, and the consistency.")
    ] = None,
) -> None:
    """Run sequences x settings x seeds and add up their metrics; goes on where it stopped."""
    if cluster is not None and workers is not None:
        raise InputError("--workers counts local processes: leave it out with --cluster")
    execute: Executor = (
        LocalProcesses(workers, retries) if cluster is None else DaskCluster(cluster, retries)
    )
    todo = read_plan(plan)
    with (
        interruptible(f"finished runs stay in {out}; the same command goes on"),
        stages() as advance,
    ):
        summary = run_batch(todo, out, execute, work, monte_carlo=monte_carlo, on_progress=advance)
    for table in summary_tables(summary, todo.metrics):
        show(table)
    for name, failure in summary.failures.items():
        say(f"ovmot: {name}: {failure}")
    if summary.failures:
        raise typer.Exit(EXIT_FAILED)


app.command()(doctor)
app.command()(calibrate)
app.command()(ros)
app.command()(ros2)


@app.command()
def warmup() -> None:
    """Compile ahead what the first run on a machine would compile."""
    ovmot.warm_up()


@app.command()
def settings() -> None:
    """List every setting with its type, default and meaning, and the presets of formats."""
    console = Console()
    if not console.is_terminal:
        for key, kind, default, meaning in ovmot.describe_settings():
            typer.echo(f"{key} = {default}  ({kind}) {meaning}")
        for line in preset_lines():
            typer.echo(line)
        return
    table = Table(Column("setting", no_wrap=True), "type", "default", "meaning")
    for row in ovmot.describe_settings():
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
    for line in preset_lines():
        console.print(Text(line))


def _bag_output(
    path: Path, recorded: RecordedSequence, video: bool, force: bool
) -> Callable[[ovmot.RunContext], ovmot.Output]:
    read, written = recorded.root.resolve(), path.resolve()
    if recorded.kind == "bag" and read in (written, *written.parents):
        raise InputError.at(path, "is the bag that is read", "choose another name with --bag")
    return lambda context: BagOutput(path, context.rig, overlay=video, replace=force)


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
