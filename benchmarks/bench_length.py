"""Time and memory along a run as long as asked for, at the level of features.

A stereo rig walks in circles between points at rest, so that after the first circle the simulation
itself needs no more memory. What the front end would see comes as `FeatureFrame`s.
"""

import gc
import os
import time
from pathlib import Path

import numpy as np

import ovmot
from bench_report import spread
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.feature_odometry import feature_odometry
from ovmot.sim.features import FeatureOptions, FeatureRecording, FeatureSimulation
from ovmot.sim.rigs import street_rig
from ovmot.sim.simulation import ImuModel
from ovmot.types import ImuNoise

COLUMNS = (
    "frames", "frame: median / p95 / max, ms", "CPU, ms", "resident memory, MB", "position error, m"
)  # fmt: skip
N_PARTS = 10
_ORIGIN_NS = 1_500_000_000_000_000_000
_RADIUS_M, _SPEED_MPS = 5.0, 1.2
_SWAY_M, _SWAY_HZ, _SWAY_RAD = 0.05, 0.9, 0.03
_MARGIN_S, _KNOT_S = 1.0, 0.1
_NOISE = ImuNoise(gyro=1.7e-4, gyro_walk=2e-5, accel=2e-3, accel_walk=3e-4)


def against_length(minutes: float) -> list[tuple[str, ...]]:
    """One run of so many minutes at 10 Hz: a row for each tenth of it.

    Raises `InputError` for less than a tenth of a minute.
    """
    if not minutes >= 0.1:
        raise ovmot.InputError(f"--minutes {minutes:g}: choose at least 0.1")
    recording = FeatureRecording(circling(minutes), seed=0)
    odometry = feature_odometry(recording, ovmot.Settings())
    n_frames = len(recording.simulation.camera_ns)
    ends = np.linspace(0, n_frames, N_PARTS + 1).astype(int)[1:]
    rows: list[tuple[str, ...]] = []
    milliseconds: list[float] = []
    begun = 0
    seen, wall, cpu = 0, 0.0, 0.0
    for event in recording.events():
        entered, cpu_entered = time.perf_counter(), time.process_time()
        results = odometry.add(event)
        wall += time.perf_counter() - entered
        cpu += time.process_time() - cpu_entered
        if results:
            milliseconds.append(1e3 * wall / len(results))
            seen, wall = seen + len(results), 0.0
        if results and seen >= ends[len(rows)]:
            error = _error_m(recording, results[-1])
            rows.append(_row(begun, seen, np.array(milliseconds), cpu, error))
            begun, milliseconds, cpu = seen, [], 0.0
    odometry.finish()
    return rows


def circling(minutes: float) -> FeatureSimulation:
    """A walk in circles, swaying, with 200 points at 4 to 12 m."""
    seconds = np.arange(0.0, 60.0 * minutes + 2.0 * _MARGIN_S, _KNOT_S)
    stamps: IntArray = _ORIGIN_NS + np.round(1e9 * (seconds - _MARGIN_S)).astype(np.int64)
    camera_ns = _ORIGIN_NS + 100_000_000 * np.arange(round(600.0 * minutes), dtype=np.int64)
    return FeatureSimulation(
        street_rig(), PoseSpline.through(stamps, _poses(seconds)), camera_ns,
        ImuModel(100.0, _NOISE, np.zeros(3), np.zeros(3)),
        FeatureOptions(n_features=200, pixel_sigma=0.5, depth_m=(4.0, 12.0)),
    )  # fmt: skip


def _poses(seconds: FloatArray) -> FloatArray:
    """T_world_imu (N, 4, 4): x of the IMU along the circle, to the left, z up."""
    turned = _SPEED_MPS / _RADIUS_M * seconds
    sway = np.sin(2.0 * np.pi * _SWAY_HZ * seconds)
    place = [_RADIUS_M * np.sin(turned), -_RADIUS_M * np.cos(turned), 1.5 + _SWAY_M * sway]
    zero = np.zeros_like(seconds)
    heading = so3.exp(np.stack([zero, zero, turned], axis=-1))
    nod = so3.exp(np.stack([zero, _SWAY_RAD * sway, zero], axis=-1))
    return se3.make(heading @ nod, np.stack(place, axis=-1))


def _error_m(recording: FeatureRecording, result: ovmot.FrameResult) -> float:
    true = recording.simulation.path.pose(result.timestamp_ns)
    return float(np.linalg.norm(result.T_world_imu[:3, 3] - true[:3, 3]))


def _row(
    begun: int, seen: int, milliseconds: FloatArray, cpu_s: float, error_m: float
) -> tuple[str, ...]:
    gc.collect()
    return (
        f"{begun} to {seen}",
        spread(milliseconds),
        f"{1e3 * cpu_s / (seen - begun):.1f}",
        f"{1e-6 * resident_bytes():.0f}",
        f"{error_m:.3f}",
    )


def resident_bytes() -> int:
    """Memory of this process that is in use now (Linux only; else 0)."""
    sizes = Path("/proc/self/statm")
    if not sizes.exists():
        return 0
    return os.sysconf("SC_PAGE_SIZE") * int(sizes.read_text().split()[1])
