"""The means of a batch side by side: a row for each list of settings, a column for each metric.

    python benchmarks/compare.py OUT [METRIC ...]

OUT is the folder of `ovmot batch`. Each sequence has its table, of means over the seeds; the last
table has the means over all sequences, each counted once. Metrics: by default those of
`plans/features.yaml`; docs/evaluation.md explains them.
"""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench_report import table

METRICS = (
    "points_a_frame", "ate_yaw_m", "point_recall", "point_precision", "object_recall",
    "object_precision", "false_boxes", "mota",
)  # fmt: skip
ALL = "all sequences"
Means = dict[tuple[str, str], dict[str, float]]
"""Mean of each metric by sequence and settings."""


def main() -> None:
    """Print the tables of one batch."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("metrics", nargs="*", default=METRICS)
    asked = parser.parse_args()
    print("\n\n".join(tables(read_means(asked.out / "summary.csv"), asked.metrics)))


def read_means(summary: Path) -> Means:
    """The means in a `summary.csv`."""
    found: Means = {}
    with summary.open(newline="", encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            key = (row["sequence"], row["settings"])
            found.setdefault(key, {})[row["metric"]] = float(row["mean"])
    return found


def tables(means: Means, metrics: Sequence[str]) -> list[str]:
    """A table for each sequence, and one of all where there are several."""
    names = list(dict.fromkeys(sequence for sequence, _ in means))
    settings = list(dict.fromkeys(name for _, name in means))
    by_sequence = {name: {s: means.get((name, s), {}) for s in settings} for name in names}
    if len(names) > 1:
        by_sequence[ALL] = {s: over_all([by_sequence[n][s] for n in names]) for s in settings}
    return [
        table((name, *metrics), [(s, *_cells(found[s], metrics)) for s in settings])
        for name, found in by_sequence.items()
    ]


def over_all(means: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means over sequences; those without the metric do not count."""
    names = dict.fromkeys(name for found in means for name in found)
    return {n: float(np.mean([found[n] for found in means if n in found])) for n in names}


def _cells(found: Mapping[str, float], metrics: Sequence[str]) -> list[str]:
    return [f"{found[metric]:.4g}" if metric in found else "-" for metric in metrics]


if __name__ == "__main__":
    main()
