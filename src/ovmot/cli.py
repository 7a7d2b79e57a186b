"""The command line: thin, and the only place that prints errors and exits."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Column, Table
from rich.text import Text

import ovmot
from ovmot.config import describe_settings, load_settings
from ovmot.datasets.registry import READERS, open_sequence
from ovmot.errors import InputError, OvmotError
from ovmot.run import RunOptions, run_sequence
from ovmot.runtime import prepare_process

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_INTERRUPTED = 1, 2, 130

app = typer.Typer(
    name="ovmot", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Stereo-inertial odometry and moving-object tracks, without learned models.",
)  # fmt: skip


def main() -> None:
    """Run the command line; errors meant for the user become one line and an exit code.

    A polite request to end (SIGTERM) is taken as Ctrl-C: what was done is kept, and said.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
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


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"ovmot {ovmot.__version__}")
        raise typer.Exit


@app.command()
def run(
    data: Annotated[Path, typer.Argument(help="Folder of a recorded sequence.")],
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
    config: Annotated[
        Path | None, typer.Option(help="YAML settings: only what differs from the defaults.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value; repeatable.")
    ] = None,
    ego: Annotated[
        tuple[str, Path] | None,
        typer.Option(
            metavar="poses FILE", help="Ego motion from a file (TUM or KITTI form), not the filter."
        ),
    ] = None,
    save_points: Annotated[
        bool, typer.Option("--save-points", help="Write points.csv and stereo.csv.")
    ] = False,
    video: Annotated[bool, typer.Option("--video", help="Write overlay.mp4.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the run that the folder holds.")
    ] = False,
    first: Annotated[int, typer.Option(min=0, help="First frame, counted from 0.")] = 0,
    last: Annotated[int | None, typer.Option(min=0, help="Last frame.")] = None,
) -> None:
    """Run a recorded sequence and write trajectory, points, tracks and timing."""
    prepare_process()
    settings = load_settings(config, set_ or ())
    recorded = open_sequence(data, format, sequence, calibration, settings.imu.max_gap_s)
    for warning in recorded.warnings:
        _say(f"ovmot: warning: {warning}")
    options = RunOptions(out, _ego_poses(ego), save_points, video, force, first, last)
    stop = len(recorded) if last is None else min(last + 1, len(recorded))
    with (
        _interruptible("what was done until here is written whole"),
        _progress("run", max(stop - first, 0)) as advance,
    ):
        summary = run_sequence(recorded, settings, options, advance)
    for warning, count in summary.warnings.items():
        if warning not in recorded.warnings:
            _say(f"ovmot: warning: {warning} ({count})")
    written = summary.counts["frames_written"]
    rate = written / max(summary.wall_seconds, 1e-9)
    typer.echo(f"{written} frames in {summary.wall_seconds:.1f} s ({rate:.1f} frames/s) -> {out}")


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


def _ego_poses(ego: tuple[str, Path] | None) -> Path | None:
    if ego is None:
        return None
    kind, path = ego
    if kind != "poses":
        raise InputError(f"--ego {kind}: unknown; write --ego poses FILE")
    return path


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
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _FramesPerSecond(),
    )
    # into a file, a bar would only be a broken line before the messages
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(task_name, total=total)
        yield lambda done: bar.update(task, completed=done)


def _say(line: str) -> None:
    typer.echo(line, err=True)
