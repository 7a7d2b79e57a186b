"""Simulate a street, run ovmot on it, and hold the result against the truth.

    python examples/demo.py [FOLDER]

Writes a KAIST-format sequence into FOLDER/data and the run into FOLDER/out (default: runs/demo).
"""

import csv
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ovmot.formats import read_euroc_ground_truth, read_tum
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim.scenes import demo_simulation
from ovmot.sim.writer import write_kaist

MOVING_MPS, MAX_DEPTH_M, EDGE_PX = 1.0, 40.0, 7


def main(folder: Path, duration_s: float = 8.0) -> None:
    """Simulate, run, compare, print."""
    start = time.monotonic()
    data, out = folder / "data", folder / "out"
    simulate(data, duration_s)
    command = [sys.executable, "-m", "ovmot", "run", str(data), "-o", str(out)]
    subprocess.run([*command, "--save-points", "--video", "--force"], check=True)
    ate_m, distance_m, frames = trajectory_error(data, out)
    precision, recall, points = label_scores(data, out)
    table = Table("", "", title="ovmot demo, against the simulator's truth", show_header=False)
    table.add_row("frames with a pose", f"{frames}")
    table.add_row("distance driven", f"{distance_m:.1f} m")
    table.add_row("trajectory error (ATE, yaw and position aligned)", f"{ate_m:.3f} m")
    table.add_row(f"dynamic points, precision ({points} points)", f"{precision:.2f}")
    table.add_row("dynamic points, recall", f"{recall:.2f}")
    table.add_row("whole demo", f"{time.monotonic() - start:.0f} s")
    console = Console()
    console.print(table)
    console.print(f"video: {out / 'overlay.mp4'}", soft_wrap=True)


def simulate(data: Path, duration_s: float) -> None:
    """Write the street's sequence, in place of an earlier demo's."""
    if data.exists():
        shutil.rmtree(data)
    simulation = demo_simulation(seed=0, duration_s=duration_s)
    frames = write_kaist(data, simulation, seed=0)
    for _ in track(frames, "render", total=len(simulation.camera_ns)):
        pass


def trajectory_error(data: Path, out: Path) -> tuple[float, float, int]:
    """RMS position error in m, distance driven in m, number of poses compared."""
    truth = read_euroc_ground_truth(data / "truth" / "poses.csv")
    run = read_tum(out / "trajectory.tum")
    _, i, j = np.intersect1d(truth.timestamp_ns, run.timestamp_ns, return_indices=True)
    p_true, p_run = truth.T_world_imu[i, :3, 3], run.T_world_imu[j, :3, 3]
    error = p_true - yaw_aligned(p_run, p_true)
    distance = np.linalg.norm(np.diff(p_true, axis=0), axis=1).sum()
    return float(np.sqrt((error**2).sum(axis=1).mean())), float(distance), len(i)


def yaw_aligned(points: FloatArray, target: FloatArray) -> FloatArray:
    """Points (N, 3), turned about z and moved so that they meet target (N, 3) best."""
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    sine = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    cosine = (a[:, :2] * b[:, :2]).sum()
    c, s = np.array([cosine, sine]) / max(float(np.hypot(cosine, sine)), 1e-12)
    R_transposed = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(a @ R_transposed + target.mean(axis=0))


def label_scores(data: Path, out: Path) -> tuple[float, float, int]:
    """Precision and recall of the label `dynamic` against the object-id pictures, and the count.

    Points near an outline, beyond `MAX_DEPTH_M` or without a verdict do not count.
    """
    truth = json.loads((data / "truth" / "objects.json").read_text())
    moving = {
        frame["t_ns"]: [
            o["id"] for o in frame["objects"] if np.hypot(o["vx"], o["vy"]) > MOVING_MPS
        ]
        for frame in truth
    }
    ids = {t: inner_ids(data / "truth" / f"{t}.png") for t in moving}
    counts = np.zeros((2, 2), dtype=np.int64)
    with (out / "points.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            t, depth = int(row["timestamp_ns"]), float(row["z_cam"] or "nan")
            height, width = ids[t].shape
            u, v = round(float(row["u"])), round(float(row["v"]))
            if not (0 <= u < width and 0 <= v < height) or row["label"] == "unknown":
                continue
            if depth < MAX_DEPTH_M and ids[t][v, u] >= 0:
                counts[int(ids[t][v, u] in moving[t]), int(row["label"] == "dynamic")] += 1
    hits = counts[1, 1]
    precision, recall = hits / max(counts[:, 1].sum(), 1), hits / max(counts[1].sum(), 1)
    return float(precision), float(recall), int(counts.sum())


def inner_ids(path: Path) -> IntArray:
    """The object-id picture (H, W), -1 near outlines."""
    ids = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    near = np.ones((EDGE_PX, EDGE_PX), np.uint8)
    edge = cv2.dilate(ids, near) != cv2.erode(ids, near)
    return np.where(edge, -1, ids.astype(np.int64))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/demo"))
