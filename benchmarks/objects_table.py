"""Tables of moving objects for BENCHMARK.md: scenes, places where nothing moves, KITTI.

    python benchmarks/objects_table.py OUT [--only scenes still drive real kitti] [--workers N]

One command makes all runs and prints Markdown. Finished runs in OUT stay: the same command goes on
where it was stopped, and prints the tables at once where nothing is missing. Scenes are the plans
`objects.yaml`, `objects_still.yaml` and `objects_drive.yaml`; real sequences are those of the test
data ($OVMOT_DATA, else ../shared/data), and are left out where they are missing.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench_inputs import data_root
from bench_report import table
from kitti_velocity import RANGE_M, compared

PLANS = Path(__file__).parent / "plans"
COLUMNS: Mapping[str, tuple[str, str]] = {
    "object_recall": ("recall", "least"),
    "object_precision": ("precision", "least"),
    "id_switches": ("id switches", "greatest"),
    "idf1": ("IDF1", "least"),
    "hota": ("HOTA", "least"),
    "object_velocity_rmse_mps": ("velocity, m/s", "greatest"),
    "two_sides_length_rmse_m": ("length, m", "greatest"),
    "object_velocity_nees": ("velocity NEES", "greatest"),
    "centre_acceleration_ratio": ("roughness", "greatest"),
    "confirmation_latency_median_s": ("latency, s", "greatest"),
    "false_tracks_per_min": ("false tracks/min", "greatest"),
}
"""Metrics by the heading of their column, and which end of their spread is the worst."""
STILL = ("confirmed_tracks", "false_boxes")
STILL_RUNS: Mapping[str, tuple[tuple[str, ...], Mapping[str, str]]] = {
    "euroc_mh01": ((), {}),
    "euroc_mh01 from frame 40": (("--first", "40"), {}),
    "euroc_mh01 from frame 80": (("--first", "80"), {}),
    "euroc_mh01 from frame 120": (("--first", "120"), {}),
    "euroc_mh01, online calibration": (
        ("--set", "calibration.extrinsics=true", "--set", "calibration.intrinsics=true"),
        {},
    ),
    "euroc_mh01, BLAS of Nehalem": ((), {"OPENBLAS_CORETYPE": "Nehalem"}),
    "euroc_mh01, BLAS of Haswell": ((), {"OPENBLAS_CORETYPE": "Haswell"}),
}
"""Runs of a room in which nothing moves: options and environment by what the table says."""
KITTI_CARS = (0, 1, 2)
"""Labelled cars of KITTI tracking 0010 that move and come nearer than 40 m."""
Spreads = Mapping[str, Mapping[str, Mapping[str, float]]]
"""mean, least and greatest by sequence and metric."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Make what is missing, then print the tables that were asked for."""
    parts = {
        "scenes": scene_tables, "still": still_tables, "drive": drive_tables,
        "real": real_tables, "kitti": kitti_tables,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the runs")
    parser.add_argument("--only", nargs="+", choices=list(parts), default=list(parts))
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    asked = parser.parse_args(arguments)
    for name in asked.only:
        for text in parts[name](asked.out, asked.workers):
            print(f"{text}\n", flush=True)


def scene_tables(out: Path, workers: int) -> list[str]:
    """A row for each scene: mean over the seeds (worst of them)."""
    spreads = read_spreads(batch(PLANS / "objects.yaml", out / "scenes", workers))
    headings = ("scene", *(heading for heading, _ in COLUMNS.values()))
    rows = [(scene, *(cell(found, name) for name in COLUMNS)) for scene, found in spreads.items()]
    return [table(headings, rows)]


def still_tables(out: Path, workers: int) -> list[str]:
    """Confirmed tracks on empty streets: mean over the seeds (worst of them)."""
    return [_still(batch(PLANS / "objects_still.yaml", out / "still", workers))]


def drive_tables(out: Path, workers: int) -> list[str]:
    """The same of five minutes of empty driving."""
    return [_still(batch(PLANS / "objects_drive.yaml", out / "drive", workers))]


def real_tables(out: Path, workers: int) -> list[str]:
    """Confirmed tracks in a real room in which nothing moves."""
    data = data_root() / "euroc_mh01"
    if not data.is_dir():
        return [f"{data} is missing"]
    rows = []
    for number, (name, (options, environment)) in enumerate(STILL_RUNS.items()):
        run = out / "real" / f"{number:02d}"
        metrics = measured(run, data, options, environment)
        rows.append((name, f"{metrics['confirmed_tracks']:.0f}"))
    return [table(("real room in which nothing moves", "confirmed tracks"), rows)]


def kitti_tables(out: Path, workers: int) -> list[str]:
    """KITTI tracking 0010 with given poses: recall, ids and speeds of the cars that move."""
    folder = data_root() / "kitti_tracking" / "training"
    if not folder.is_dir():
        return [f"{folder} is missing"]
    poses, run = folder / "poses" / "0010.txt", out / "kitti_0010"
    measured(run, folder, ("--ego", "poses", str(poses)), {})
    cars = compared(folder / "label_02" / "0010.txt", poses, run, KITTI_CARS)
    rows = [
        (
            str(car.vehicle), str(car.frames), str(car.tracked), str(len(car.ids)),
            f"{car.speed:.1f}",
            f"{np.median(car.off):.2f} / {max(car.off):.2f}" if car.off else "",
        )
        for car in cars
    ]  # fmt: skip
    recall = sum(car.tracked for car in cars) / sum(car.frames for car in cars)
    headings = (
        "KITTI 0010, car", f"frames within {RANGE_M:g} m", "tracked in", "ids", "speed, m/s",
        "velocity off, median / most, m/s",
    )  # fmt: skip
    return [table(headings, rows), f"Recall of these cars: {recall:.2f}."]


def batch(plan: Path, out: Path, workers: int) -> Path:
    """Run a plan, or go on with it, and return its summary; raises `SystemExit` where it fails."""
    command = ("batch", str(plan), "-o", str(out), "--workers", str(workers))
    ovmot(command, {})
    return out / "summary.csv"


def measured(
    run: Path, data: Path, options: Sequence[str], environment: Mapping[str, str]
) -> Mapping[str, float]:
    """The metrics of a run on recorded data, which is made where it is not finished."""
    metrics = run / "metrics.json"
    if not metrics.is_file():
        run.parent.mkdir(parents=True, exist_ok=True)
        ovmot(("run", str(data), "-o", str(run), "--force", *options), environment)
        ovmot(("evaluate", str(run), "--no-plots"), environment)
    found: Mapping[str, float] = json.loads(metrics.read_text(encoding="utf-8"))
    return found


def ovmot(command: Sequence[str], environment: Mapping[str, str]) -> None:
    """Run one command of ovmot, silently; raises `SystemExit` with its last line where it fails."""
    done = subprocess.run(
        (sys.executable, "-m", "ovmot", *command),
        env={**os.environ, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        sys.exit(f"ovmot {' '.join(command)}: {done.stderr.strip().splitlines()[-1:]}")


def read_spreads(summary: Path) -> Spreads:
    """Mean, least and greatest of a batch's metrics, by sequence."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    with summary.open(newline="", encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            values = {key: float(row[key]) for key in ("mean", "least", "greatest")}
            found.setdefault(row["sequence"], {})[row["metric"]] = values
    return found


def cell(metrics: Mapping[str, Mapping[str, float]], name: str) -> str:
    """Mean (worst), empty where no run has a value; of NEES both ends, since both are bad."""
    found = metrics.get(name)
    if found is None:
        return ""
    worst = f"{found[COLUMNS[name][1]]:.2f}"
    if name.endswith("_nees"):
        worst = f"{found['least']:.2f} ... {found['greatest']:.2f}"
    return f"{found['mean']:.2f} ({worst})"


def _still(summary: Path) -> str:
    rows = [
        (scene, *(f"{found[name]['mean']:.1f} ({found[name]['greatest']:.0f})" for name in STILL))
        for scene, found in read_spreads(summary).items()
    ]
    return table(("empty street", "confirmed tracks", "false boxes"), rows)


if __name__ == "__main__":
    main()
