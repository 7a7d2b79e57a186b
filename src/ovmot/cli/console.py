"""What commands say: lines, tables, bars, and what an interruption leaves."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

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
from rich.table import Table
from rich.text import Text

import ovmot
from ovmot.errors import is_interrupt
from ovmot.kernels.cache import is_first_use

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_INTERRUPTED = 1, 2, 130
NOTHING_WRITTEN = "nothing was written"
_WIDE = 160


def say(line: str) -> None:
    """Print a line that is no result."""
    typer.echo(printable(line), err=True)


def printable(line: str) -> str:
    """What a file or its name makes us say can not steer the terminal, nor is it always UTF-8."""
    return "".join(c if c.isprintable() else "?" for c in line)


def nothing_is_compiled() -> bool:
    """Is this the first run on a machine? To be asked before a calibration is read, which compiles
    the first of the kernels."""
    return is_first_use(Path(ovmot.__file__).parent)


def compile_where(needed: bool) -> None:
    """Compile the kernels where that is needed, and say so."""
    if needed:
        say("ovmot: the first run on this machine compiles some code; that takes about a minute")
        ovmot.warm_up()


def say_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """What `warnings.showwarning` is for the command line: one line, without its place."""
    say(f"ovmot: warning: {message}")


def show(table: Table) -> None:
    """Print a table; where nobody watches, as wide as it is."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDE)
    console.print(table)


@contextmanager
def interruptible(what_is_left: str) -> Iterator[None]:
    """Say what Ctrl-C leaves and exit; here, since Typer would swallow it without a word."""
    try:
        yield
    except BaseException as error:
        if not is_interrupt(error):
            raise
        say(f"ovmot: interrupted; {what_is_left}")
        raise typer.Exit(EXIT_INTERRUPTED) from None


@contextmanager
def progress(task_name: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar of frames, with their rate."""
    with _bar(_FramesPerSecond()) as bar:
        task = bar.add_task(task_name, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each stage (name, how many are done, of how many)."""
    with _bar(TimeElapsedColumn()) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done, total=total)

        yield advance


class _FramesPerSecond(ProgressColumn):
    """The rate so far."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "- frames/s")


def _bar(last_column: ProgressColumn) -> Progress:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), last_column)
    # into a file, a bar would only be a broken line before the messages
    return Progress(*columns, console=console, disable=not console.is_terminal)
