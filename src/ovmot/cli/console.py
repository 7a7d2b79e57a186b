"""What commands say: lines, tables, and what an interruption leaves."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

import typer

from ovmot.errors import is_interrupt

if TYPE_CHECKING:
    from rich.table import Table

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_INTERRUPTED = 1, 2, 130
NOTHING_WRITTEN = "nothing was written"
_WIDE = 160


def say(line: str) -> None:
    """Print a line that is no result."""
    typer.echo(printable(line), err=True)


def printable(line: str) -> str:
    """What a file or its name makes us say can not steer the terminal, nor is it always UTF-8."""
    return "".join(c if c.isprintable() else "?" for c in line)


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


def show(table: "Table") -> None:
    """Print a table; where nobody watches, as wide as it is."""
    from rich.console import Console

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
