"""A batch: render the sequences, run the odometry, evaluate, summarize."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ovmot.batch.execute import Executor, Work
from ovmot.batch.jobs import Job, RunJob, is_done, render_jobs, result_of, run_jobs
from ovmot.batch.page import write_batch_page
from ovmot.batch.plan import Plan, Rendered
from ovmot.batch.summary import BatchSummary, consistency_of, spreads_of, write_summary
from ovmot.errors import InputError

Progress = Callable[[str, int, int], None]
"""Called with what is going on, how many of it are done, and of how many."""


def run_batch(
    plan: Plan,
    out: Path,
    execute: Executor,
    work: Work,
    *,
    monte_carlo: int | None = None,
    on_progress: Progress = lambda *_: None,
) -> BatchSummary:
    """Do the jobs of a plan that are not done yet, and write `summary.csv`, `summary.json` and
    `report.html` into `out`.

    `monte_carlo` takes the seeds 0 to N-1 in place of the plan's, and judges the consistency. Jobs
    that fail are listed and do not hold up the others; what is finished stays whatever happens.
    Raises `InputError` for a folder that cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError.at(out, f"cannot be made: {error.strerror}", "choose another") from None
    seeds = plan.seed_list if monte_carlo is None else tuple(range(monte_carlo))
    runs = run_jobs(plan, out, seeds)
    todo = tuple(run for run in runs if not is_done(run))
    failures = _do("render", execute, work, render_jobs(todo), on_progress)
    ready = tuple(run for run in todo if _has_data(run))
    lost = {run.name: "was not rendered" for run in todo if not _has_data(run)}
    failures |= lost | _do("run", execute, work, ready, on_progress)
    if not plan.keep_data:
        _delete_data(runs, failures)
    done = tuple(run for run in runs if is_done(run))
    results = _by_settings(done)
    summary = BatchSummary(
        spreads_of(results),
        () if monte_carlo is None else consistency_of(results),
        len(done),
        failures,
    )
    write_summary(out, summary)
    write_batch_page(out, summary, done, plan.metrics)
    return summary


def _do(
    name: str, execute: Executor, work: Work, jobs: Sequence[Job], on_progress: Progress
) -> dict[str, str]:
    """Execute jobs; gives the failures by name."""
    failures: dict[str, str] = {}
    if jobs:
        on_progress(name, 0, len(jobs))
    for done, outcome in enumerate(execute(work, jobs) if jobs else (), start=1):
        if outcome.failure is not None:
            failures[outcome.name] = outcome.failure
        on_progress(name, done, len(jobs))
    return failures


def _has_data(run: RunJob) -> bool:
    return not isinstance(run.sequence, Rendered) or (run.data is not None and run.data.is_dir())


def _delete_data(runs: Sequence[RunJob], failures: Mapping[str, str]) -> None:
    """Rendered sequences whose runs are all done."""
    needed = {run.data for run in runs if run.name in failures}
    for run in runs:
        if isinstance(run.sequence, Rendered) and run.data is not None and run.data not in needed:
            shutil.rmtree(run.data, ignore_errors=True)


def _by_settings(
    done: Sequence[RunJob],
) -> dict[tuple[str, str], list[Mapping[str, float | None]]]:
    """Metrics of the finished runs by sequence and settings, in order of the seeds."""
    out: dict[tuple[str, str], list[Mapping[str, float | None]]] = {}
    for run in sorted(done, key=lambda run: run.seed):
        result = result_of(run)
        if result is not None:
            out.setdefault((run.sequence_name, run.settings_name), []).append(result)
    return out
