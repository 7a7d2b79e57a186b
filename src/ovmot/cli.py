"""The command line: thin, and the only place that prints errors and exits."""

import io
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column, Table
from rich.text import Text

import ovmot
from ovmot.batch.batch import run_batch
from ovmot.batch.execute import DaskCluster, Executor, LocalProcesses
from ovmot.batch.plan import read_plan
from ovmot.batch.summary import summary_tables
from ovmot.batch.work import work
from ovmot.config import describe_settings
from ovmot.datasets.bag_topics import BagTopics
from ovmot.datasets.registry import READERS, open_recording
from ovmot.datasets.sequence import RecordedSequence
from ovmot.doctor.examine import examine, sampled_frames
from ovmot.doctor.report import report_table, write_report
from ovmot.errors import InputError, OvmotError
from ovmot.evaluate import evaluate_run, metrics_table, write_metrics, write_plots
from ovmot.kernel_cache import is_first_use
from ovmot.openvins import load_run_config
from ovmot.outputs.run_writer import Output, RunContext
from ovmot.ros.bag_output import BagOutput
from ovmot.run import RunOptions, run_sequence
from ovmot.runtime import prepare_process
from ovmot.sim.scene_file import SCENES, load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.sim.writers import WRITERS

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_INTERRUPTED = 1, 2, 130
_WIDE = 160
_NOTHING_WRITTEN = "nothing was written"

app = typer.Typer(
    name="ovmot", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Stereo-inertial odometry and moving-object tracks, without learned models.",
)  # fmt: skip


def main() -> None:
    """Run the command line; errors meant for the user become one line and an exit code.

    A polite request to end (SIGTERM) is taken as Ctrl-C: what was done is kept, and said.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # the names of files need not be text
    try:
        app()
    except InputError as error:
        _say(f"ovmot: {error}")
        sys.exit(EXIT_BAD_INPUT)
    except OvmotError as error:
        _say(f"ovmot: {error}")
        sys.exit(EXIT_FAILED)
    except OSError as error:  # a folder that may not be read
        _say(f"ovmot: {error}")
        sys.exit(EXIT_BAD_INPUT)
    except MemoryError:
        _say("ovmot: out of memory: give a shorter or smaller sequence")
        sys.exit(EXIT_FAILED)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"ovmot {ovmot.__version__}")
        raise typer.Exit


@app.command()
def run(
    data: Annotated[
        Path,
        typer.Argument(help="Folder of a recorded sequence, or a ROS bag: .bag, .mcap, .db3."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into.")],
    format: Annotated[
        str | None, typer.Option(help=f"Kind of data: {', '.join(READERS)}; else recognised.")
    ] = None,
    sequence: Annotated[
        str | None, typer.Option(help="Which sequence, where the folder holds several.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Kalibr chain file, in place of the data's calibration.")
    ] = None,
    left: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's left camera; else found.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's right camera; else found.")
    ] = None,
    imu: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's IMU; else found.")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="YAML of settings that differ, or an estimator_config.yaml of OpenVINS."),
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value; repeatable.")
    ] = None,
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
) -> None:
    """Run a recorded sequence and write trajectory, points, tracks and timing."""
    prepare_process()
    overrides = [*(set_ or ()), *(["objects.enabled=false"] if no_objects else [])]
    given = load_run_config(config, overrides)
    settings = given.settings
    with _interruptible(_NOTHING_WRITTEN):
        recorded = open_recording(
            data,
            format,
            sequence,
            calibration or given.calibration,
            settings.imu.max_gap_s,
            BagTopics(left, right, imu),
        )
    recorded = replace(recorded, warnings=(*given.warnings, *recorded.warnings))
    for warning in recorded.warnings:
        _say(f"ovmot: warning: {warning}")
    more = () if bag is None else (_bag_output(bag, recorded, video, force),)
    options = RunOptions(
        out, _ego_poses(ego), save_points, video, force, first, last, masks, more, given.mask_files
    )
    stop = len(recorded) if last is None else min(last + 1, len(recorded))
    if is_first_use(Path(ovmot.__file__).parent):
        _say("ovmot: the first run on this machine compiles some code; that takes up to a minute")
    with (
        _interruptible("what was done until here is written whole"),
        _progress("run", max(stop - first, 0)) as advance,
    ):
        summary = run_sequence(
            recorded, settings, options, advance, lambda why: _say(f"ovmot: {why}")
        )
    for warning, count in summary.warnings.items():
        if warning not in recorded.warnings:
            _say(f"ovmot: warning: {warning} ({count})")
    written = summary.counts["frames_written"]
    rate = written / max(summary.wall_seconds, 1e-9)
    took = f"{summary.wall_seconds:.1f} s ({rate:.1f} frames/s)"
    typer.echo(_printable(f"{written} frames in {took} -> {out}"))


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write into: new or empty.")],
    scene: Annotated[
        str, typer.Option(help=f"A scene ({', '.join(SCENES)}) or a YAML file of one.")
    ] = "traffic",
    path: Annotated[
        str | None,
        typer.Option(
            help="The rig's path: stand, walk, drive, or a TUM file; else the scene's own."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another street.")] = 0,
    format: Annotated[str, typer.Option(help=f"Layout: {', '.join(WRITERS)}.")] = "kaist",
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
    prepare_process()
    write = WRITERS.get(format)
    if write is None:
        raise InputError(f"--format {format}: unknown; choose one of {', '.join(WRITERS)}")
    simulation = make_simulation(
        load_scene(scene), seed=seed, path=path, size=_size(size), rate_hz=rate, duration_s=duration
    )
    total = len(simulation.camera_ns)
    with (
        _interruptible(f"{out} holds an unfinished sequence: delete it"),
        _progress("simulate", total) as advance,
    ):
        for done, _ in enumerate(write(out, simulation, seed), start=1):
            advance(done)
    typer.echo(_printable(f"{total} frames -> {out}"))


@app.command()
def evaluate(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    truth: Annotated[
        Path, typer.Option("--truth", help="The sequence with its truth, or a TUM file.")
    ],
    plots: Annotated[bool, typer.Option(help="Draw plots beside metrics.json.")] = True,
) -> None:
    """Hold a run against the truth: a table, metrics.json and plots, written into the run."""
    with _interruptible(_NOTHING_WRITTEN):
        evaluation = evaluate_run(run, truth)
    write_metrics(run, evaluation)
    if plots:
        write_plots(run, evaluation)
    _show(metrics_table(evaluation))


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
        _interruptible(f"finished runs stay in {out}; the same command goes on"),
        _stages() as advance,
    ):
        summary = run_batch(todo, out, execute, work, monte_carlo=monte_carlo, on_progress=advance)
    for table in summary_tables(summary, todo.metrics):
        _show(table)
    for name, failure in summary.failures.items():
        _say(f"ovmot: {name}: {failure}")
    if summary.failures:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def doctor(
    data: Annotated[Path, typer.Argument(help="Folder of a recorded sequence, or a ROS bag.")],
    format: Annotated[
        str | None, typer.Option(help=f"Kind of data: {', '.join(READERS)}; else recognised.")
    ] = None,
    sequence: Annotated[
        str | None, typer.Option(help="Which sequence, where the folder holds several.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Kalibr chain file, in place of the data's calibration.")
    ] = None,
    left: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's left camera; else found.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's right camera; else found.")
    ] = None,
    imu: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of a bag's IMU; else found.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the findings as JSON as well.")
    ] = None,
) -> None:
    """Say what is wrong or doubtful in a sequence before it is run; exit code 1 if anything is."""
    prepare_process()
    with _interruptible(_NOTHING_WRITTEN):
        recorded = open_recording(
            data, format, sequence, calibration, topics=BagTopics(left, right, imu)
        )
    with (
        _interruptible(_NOTHING_WRITTEN),
        _progress("doctor", sampled_frames(recorded)) as advance,
    ):
        report = examine(recorded, advance, calibration)
    _show(report_table(report))
    if json is not None:
        write_report(json, report)
    if report.is_wrong:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def ros(
    remappings: Annotated[
        list[str] | None, typer.Argument(help="ROS's own arguments: a:=b, __name:=c.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Kalibr chain, or a data set's folder.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML settings; topics are in the section `live`.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value; repeatable.")
    ] = None,
) -> None:
    """Run live on ROS 1: two image topics and an IMU in, odometry and objects out."""
    from ovmot.ros.ros1_node import run_node

    strange = [text for text in remappings or () if ":=" not in text]
    if strange:
        raise InputError(f"{strange[0]}: neither an option nor a remapping a:=b")
    prepare_process()
    with _interruptible("the node has ended"):
        run_node(config, calibration, tuple(set_ or ()))


@app.command()
def ros2(
    arguments: Annotated[
        list[str] | None, typer.Argument(help="ROS's own arguments: -- --ros-args ...")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Kalibr chain, or a data set's folder.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML settings; topics are in the section `live`.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value; repeatable.")
    ] = None,
) -> None:
    """Run live on ROS 2: two image topics and an IMU in, odometry and objects out."""
    from ovmot.ros.ros2_node import run_node

    prepare_process()
    with _interruptible("the node has ended"):
        run_node(config, calibration, tuple(set_ or ()), tuple(arguments or ()))


@app.command()
def settings() -> None:
    """List every setting with its type, default and meaning."""
    console = Console()
    if not console.is_terminal:
        for key, kind, default, meaning in describe_settings():
            typer.echo(f"{key} = {default}  ({kind}) {meaning}")
        return
    table = Table(Column("setting", no_wrap=True), "type", "default", "meaning")
    for row in describe_settings():
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def _bag_output(
    path: Path, recorded: RecordedSequence, video: bool, force: bool
) -> Callable[[RunContext], Output]:
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


@contextmanager
def _interruptible(what_is_left: str) -> Iterator[None]:
    """Say what Ctrl-C leaves and exit; here, since Typer would swallow it without a word."""
    try:
        yield
    except KeyboardInterrupt:
        _say(f"ovmot: interrupted; {what_is_left}")
        raise typer.Exit(EXIT_INTERRUPTED) from None


class _FramesPerSecond(ProgressColumn):
    """The rate so far."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "- frames/s")


@contextmanager
def _progress(task_name: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar of frames, with their rate."""
    with _bar(_FramesPerSecond()) as bar:
        task = bar.add_task(task_name, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _stages() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each stage (name, how many are done, of how many)."""
    with _bar(TimeElapsedColumn()) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done, total=total)

        yield advance


def _bar(last_column: ProgressColumn) -> Progress:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), last_column)
    # into a file, a bar would only be a broken line before the messages
    return Progress(*columns, console=console, disable=not console.is_terminal)


def _show(table: Table) -> None:
    """Print a table; where nobody watches, as wide as it is."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDE)
    console.print(table)


def _say(line: str) -> None:
    typer.echo(_printable(line), err=True)


def _printable(line: str) -> str:
    """What a file or its name makes us say can not steer the terminal, nor is it always UTF-8."""
    return "".join(c if c.isprintable() else "?" for c in line)
