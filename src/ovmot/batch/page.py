"""`report.html` of a batch: its table, spreads, and the worst runs with links to their pages."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ovmot.batch.jobs import RunJob, result_of
from ovmot.batch.summary import USUAL_METRICS, BatchSummary, Spread
from ovmot.report.page import batch_page
from ovmot.report.report import REPORT_FILE, write_page

_MORE_IS_BETTER = (
    "object_recall", "object_precision", "idf1", "hota", "point_precision", "point_recall",
    "static_kept",
)  # fmt: skip
_EXPECTED = {"nees_orientation": 3.0, "nees_position": 3.0, "object_velocity_nees": 3.0}
"""Metrics that have a right value, and are the worse the farther they are from it by ratio."""


def write_batch_page(
    out: Path, summary: BatchSummary, done: Sequence[RunJob], metrics: Sequence[str] | None
) -> Path:
    """Write the page of the finished runs into `out`; `metrics` are those shown first, None for
    the usual ones. Raises `OvmotError` where it cannot be written.
    """
    path = out / REPORT_FILE
    contents = batch_contents(out, summary, done, tuple(metrics or USUAL_METRICS))
    write_page(path, batch_page(contents))
    return path


def batch_contents(
    out: Path, summary: BatchSummary, done: Sequence[RunJob], metrics: tuple[str, ...]
) -> dict[str, Any]:
    """What the page tells, as values of JSON."""
    runs = [_run(out, job, metrics) for job in sorted(done, key=lambda job: job.name)]
    return {
        "name": out.resolve().name,
        "failures": summary.failures,
        "metrics": list(metrics),
        "runs": runs,
        "spreads": [
            asdict(spread)
            | {"usual": spread.metric in metrics, "values": [v for _, v in _values(runs, spread)]}
            for spread in summary.spreads
        ],
        "worst": [
            _worst(runs, spread)
            for spread in summary.spreads
            if spread.metric in metrics and (spread.least < spread.greatest or spread.count == 1)
        ],
        "consistency": [asdict(row) for row in summary.consistency],
    }  # fmt: skip


def _run(out: Path, job: RunJob, metrics: tuple[str, ...]) -> dict[str, Any]:
    report = job.folder / REPORT_FILE
    found = result_of(job) or {}
    link = quote(report.relative_to(out).as_posix()) if report.is_file() else None
    return {
        "name": job.name, "sequence": job.sequence_name, "settings": job.settings_name,
        "report": link, "metrics": {k: v for k, v in found.items() if v is not None},
    }  # fmt: skip


def _values(runs: list[dict[str, Any]], spread: Spread) -> list[tuple[int, float]]:
    """Index and value of the runs that a spread is of."""
    return [
        (i, float(run["metrics"][spread.metric]))
        for i, run in enumerate(runs)
        if (run["sequence"], run["settings"]) == (spread.sequence, spread.settings)
        and spread.metric in run["metrics"]
    ]


def _worst(runs: list[dict[str, Any]], spread: Spread) -> dict[str, Any]:
    values = _values(runs, spread)
    index, value = max(values, key=lambda entry: badness(spread.metric, entry[1]))
    return {"metric": spread.metric, "run": index, "value": value, "median": spread.median}


def badness(metric: str, value: float) -> float:
    """A number that is the greater the worse a metric's value is."""
    if metric in _MORE_IS_BETTER:
        return -value
    if metric in _EXPECTED:
        return abs(math.log(max(value, 1e-9) / _EXPECTED[metric]))
    return value
