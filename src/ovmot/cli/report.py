"""`ovmot report`, and the page at the end of a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ovmot.cli.console import NOTHING_WRITTEN, interruptible, printable, say
from ovmot.errors import is_interrupt

if TYPE_CHECKING:
    from ovmot.cli.progress import Style


def report(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs; several side by side.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FILE",
            help="The page; else report.html in the run, or here for several.",
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Data with true poses, or a TUM file; else what each run has read."),
    ] = None,
) -> None:  # fmt: skip
    """Make a page of finished runs: map, overlay, plots, tables; it works offline."""
    import ovmot

    with interruptible(NOTHING_WRITTEN):
        path = ovmot.write_report(runs, out, truth)
    typer.echo(printable(f"-> {path}"))


def report_of_run(out: Path, style: "Style") -> None:
    """Make the page of a run that has ended; what goes wrong there is one warning."""
    import ovmot
    from ovmot.cli.progress import say_event

    try:
        with interruptible(f"the run is whole; make its page by 'ovmot report {out}'"):
            path = ovmot.write_report([out])
    except Exception as error:
        if is_interrupt(error) or isinstance(error, typer.Exit):
            raise
        say(f"ovmot: warning: no report.html: {error}")
    else:
        say_event(style, "report", f"report -> {path}", path=str(path))
