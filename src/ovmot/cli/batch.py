"""`ovmot batch`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ovmot.cli.console import EXIT_FAILED, interruptible, say, show
from ovmot.cli.options import JsonLinesOption, QuietOption
from ovmot.errors import InputError

if TYPE_CHECKING:
    from ovmot.batch.execute import Executor


def batch(
    plan: Annotated[Path, typer.Argument(help="YAML file: sequences, settings, seeds.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into, or to go on in.")],
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Local processes; else one a core.")
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, in place of local processes."),
    ] = None,
    retries: Annotated[
        int,
        typer.Option(min=0, metavar="N", help="How often a run whose worker died is tried again."),
    ] = 2,
    monte_carlo: Annotated[
        int | None, typer.Option(min=2, metavar="N", help="Seeds 0 to N-1, and the consistency.")
    ] = None,
    quiet: QuietOption = False,
    json_lines: JsonLinesOption = False,
) -> None:
    """Run sequences x settings x seeds and add up their metrics; goes on where it stopped."""
    if cluster is not None and workers is not None:
        raise InputError("--workers counts local processes: leave it out with --cluster")
    from ovmot.batch.batch import run_batch
    from ovmot.batch.execute import DaskCluster, LocalProcesses
    from ovmot.batch.plan import read_plan
    from ovmot.batch.summary import summary_tables
    from ovmot.batch.work import work
    from ovmot.cli.progress import say_event, stages, style_of

    style = style_of(quiet, json_lines)
    execute: Executor = (
        LocalProcesses(workers, retries, _say) if cluster is None
        else DaskCluster(cluster, retries, on_death=_say)
    )  # fmt: skip
    todo = read_plan(plan)
    with (
        interruptible(f"finished runs stay in {out}; the same command goes on"),
        stages(style) as advance,
    ):
        summary = run_batch(todo, out, execute, work, monte_carlo=monte_carlo, on_progress=advance)
    for table in summary_tables(summary, todo.metrics):
        show(table)
    for name, failure in summary.failures.items():
        say(f"ovmot: {name}: {failure}")
    page = out / "report.html"
    say_event(style, "report", f"report -> {page}", path=str(page))
    if summary.failures:
        raise typer.Exit(EXIT_FAILED)


def _say(line: str) -> None:
    say(f"ovmot: warning: {line}")
