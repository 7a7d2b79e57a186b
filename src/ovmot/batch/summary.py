"""The figures of many runs: mean, median and spread over the seeds, and consistency."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from ovmot.errors import OvmotError
from ovmot.evaluation.consistency import average_bounds

USUAL_METRICS = (
    "ate_yaw_m", "ate_yaw_deg", "ate_percent", "rpe_1s_m", "nees_orientation", "nees_position",
    "object_recall", "object_precision", "id_switches", "idf1", "hota",
    "object_velocity_rmse_mps", "object_velocity_nees", "false_tracks_per_min",
    "two_sides_length_rmse_m", "centre_acceleration_ratio", "detection_latency_median_s",
    "pull_out_latency_median_s", "point_precision", "point_recall", "static_kept",
)  # fmt: skip
_NAMES = ("sequence", "settings", "metric")
_NEES_DOF = {"nees_orientation": 3, "nees_position": 3, "nees_pose": 6}
_OBJECT_NEES_DOF = {
    "object_velocity_nees": 3, "object_position_nees": 3, "object_size_nees": 3,
    "object_heading_nees": 1, "object_yaw_rate_nees": 1,
}  # fmt: skip
_OBJECT_NEES_SHARE = 0.5, 2.0  # of the dimension


@dataclass(frozen=True, slots=True)
class Spread:
    """One metric over the seeds of one sequence and settings: `count` runs have a value.

    `std` is that of the sample, None for a single run.
    """

    sequence: str
    settings: str
    metric: str
    count: int
    mean: float
    median: float
    std: float | None
    least: float
    greatest: float


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mean NEES over the runs of one sequence and settings, and the band that it should keep.

    The band of the rig's is the 95 % one of a mean over the runs at one time (Y. Bar-Shalom et al.
    2001, sec. 5.4.2); the mean over time as well varies less, so that a consistent filter is inside
    more often. How many objects a run meets, and how alike their errors are, is not known: theirs
    goes from half the dimension to twice it.
    """

    sequence: str
    settings: str
    metric: str
    runs: int
    mean: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        return self.low <= self.mean <= self.high


@dataclass(frozen=True, slots=True)
class BatchSummary:
    """All metrics of all runs, and the runs that failed, by name, with their line."""

    spreads: tuple[Spread, ...]
    consistency: tuple[Consistency, ...]
    finished: int
    failures: dict[str, str]


Results = Mapping[tuple[str, str], Sequence[Mapping[str, float | None]]]


def spreads_of(results: Results) -> tuple[Spread, ...]:
    """Every metric that some run has a value for, by sequence and settings."""
    out = []
    for (sequence, settings), runs in results.items():
        for metric in dict.fromkeys(name for run in runs for name in run):
            values = _values(runs, metric)
            if len(values):
                out.append(_spread(sequence, settings, metric, values))
    return tuple(out)


def consistency_of(results: Results) -> tuple[Consistency, ...]:
    """NEES against its band, for all that state a covariance."""
    out = []
    for (sequence, settings), runs in results.items():
        for metric, dof in _NEES_DOF.items():
            values = _values(runs, metric)
            if len(values):
                low, high = average_bounds(dof, len(values))
                out.append(_consistency(sequence, settings, metric, values, low, high))
        for metric, dof in _OBJECT_NEES_DOF.items():
            values = _values(runs, metric)
            if len(values):
                low, high = (share * dof for share in _OBJECT_NEES_SHARE)
                out.append(_consistency(sequence, settings, metric, values, low, high))
    return tuple(out)


def write_summary(out: Path, summary: BatchSummary) -> None:
    """Write `summary.csv` and `summary.json`; raises `OvmotError` where that is not possible."""
    try:
        with (out / "summary.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(Spread.__dataclass_fields__)
            writer.writerows(asdict(spread).values() for spread in summary.spreads)
        text = json.dumps(
            {
                "finished": summary.finished,
                "failures": summary.failures,
                "metrics": [asdict(spread) for spread in summary.spreads],
                "consistency": [{**asdict(c), "inside": c.inside} for c in summary.consistency],
            },
            indent=2,
        )
        (out / "summary.json").write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OvmotError(f"{error.filename or out}: cannot be written: {error.strerror}") from None


def summary_tables(summary: BatchSummary, metrics: Sequence[str] | None) -> tuple[Table, ...]:
    """Tables for a terminal: the chosen metrics, and the consistency where it was asked for."""
    table = Table(title=f"{summary.finished} runs")
    columns = ("sequence", "settings", "metric", "runs", "mean", "median", "std", "min", "max")
    for column in columns:
        table.add_column(column, no_wrap=column in _NAMES)
    shown = set(metrics or USUAL_METRICS)
    for s in summary.spreads:
        if s.metric in shown:
            figures = (s.mean, s.median, s.std, s.least, s.greatest)
            table.add_row(s.sequence, s.settings, s.metric, str(s.count), *map(_figure, figures))
    if not summary.consistency:
        return (table,)
    second = Table(title="consistency: mean NEES over the runs, and its band")
    for column in ("sequence", "settings", "metric", "runs", "mean", "band", ""):
        second.add_column(column, no_wrap=column in _NAMES)
    for c in summary.consistency:
        band = f"{c.low:.2f} ... {c.high:.2f}"
        verdict = "inside" if c.inside else "too cautious" if c.mean < c.low else "overconfident"
        row = (c.sequence, c.settings, c.metric, str(c.runs), f"{c.mean:.2f}", band, verdict)
        second.add_row(*row)
    return table, second


def _consistency(
    sequence: str, settings: str, metric: str, values: np.ndarray, low: float, high: float
) -> Consistency:
    mean = float(values.mean())
    return Consistency(sequence, settings, metric, len(values), mean, low, high)


def _spread(sequence: str, settings: str, metric: str, values: np.ndarray) -> Spread:
    return Spread(
        sequence, settings, metric, len(values), float(values.mean()), float(np.median(values)),
        float(values.std(ddof=1)) if len(values) > 1 else None,
        float(values.min()), float(values.max()),
    )  # fmt: skip


def _values(runs: Sequence[Mapping[str, float | None]], metric: str) -> np.ndarray:
    found = [run[metric] for run in runs if run.get(metric) is not None]
    return np.array(found, dtype=np.float64)


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
