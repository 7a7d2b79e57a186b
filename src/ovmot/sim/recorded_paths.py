"""Paths from recorded trajectories: a TUM file of IMU poses becomes a continuous motion.

Recorded poses carry noise and small jumps; a spline through them all turns 4 cm of noise at 20 Hz
into accelerations of 60 m/s². So the poses are smoothed first (`low_pass`), no more than it takes
to have accelerations that a person or a car can make.
"""

from pathlib import Path

import numpy as np

from ovmot.datasets.pose_files import Trajectory, read_tum
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.smoothing import low_pass
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.paths import MARGIN_S

CUTOFFS_HZ = (8.0, 4.0, 2.0, 1.0, 0.5)
PLAUSIBLE_ACCELERATION_MPS2 = 4.0
"""RMS over a path. Walking has 2 to 3 m/s², driving 1 to 2."""
MAX_GAP_S = 0.5
_STEP_S = 0.05
_LEAST_POSES = 10
_GRAVITY_AXIS = np.array([0.0, 0.0, 1.0])


def recorded_path(
    path: Path,
    origin_ns: int,
    *,
    start_s: float = 0.0,
    duration_s: float | None = None,
    T_scene_recorded: FloatArray | None = None,
    max_gap_s: float = MAX_GAP_S,
    cutoff_hz: float | None = None,
) -> PoseSpline:
    """T_world_imu(t) along the poses of a TUM file, smoothed at `cutoff_hz`.

    The first `start_s` of the recording are left out; the next `MARGIN_S` lie before `origin_ns`,
    and `duration_s` and another `MARGIN_S` come after it (default: up to the recording's end).
    `T_scene_recorded` (4, 4), a turn about the vertical and a shift, moves the path into a scene.
    Without `cutoff_hz`, it is the highest of `CUTOFFS_HZ` whose RMS acceleration is plausible.
    Raises `InputError` for a bad file, a piece that it does not hold, or a hole in it longer than
    `max_gap_s`; `ValueError` for a placement that would tilt the path.
    """
    placement = np.eye(4) if T_scene_recorded is None else T_scene_recorded
    if np.abs(placement[:3, 2] - _GRAVITY_AXIS).max() > 1e-9:
        raise ValueError("a path may be turned about the vertical only: gravity must stay down")
    whole = read_tum(path)
    piece = _piece(path, whole, start_s, duration_s)
    _refuse_gaps(path, piece.timestamp_ns, start_s, max_gap_s)
    moved = Trajectory(piece.timestamp_ns + origin_ns, placement @ piece.T_world_imu)
    if cutoff_hz is not None:
        return _smoothed(moved, cutoff_hz)
    for cutoff in CUTOFFS_HZ:
        smoothed = _smoothed(moved, cutoff)
        if rms_acceleration(smoothed) <= PLAUSIBLE_ACCELERATION_MPS2:
            return smoothed
    problem = f"accelerations of {rms_acceleration(smoothed):.1f} m/s² RMS even when smoothed"
    raise InputError.at(path, problem, "positions are in metres, stamps in seconds; check both")


def placement_at(
    path: PoseSpline, timestamp_ns: int, xy: tuple[float, float], yaw: float, axis: FloatArray
) -> FloatArray:
    """T_scene_recorded (4, 4) that brings the path to `xy` with heading `yaw` at one time.

    The heading is that of the body's `axis` (3,), such as the optical axis `T_imu_cam0[:3, 2]`,
    seen from above. Heights, roll and pitch stay.
    """
    T_world_body = path.pose(timestamp_ns)
    ahead = T_world_body[:3, :3] @ axis
    R = so3.exp((yaw - np.arctan2(ahead[1], ahead[0])) * _GRAVITY_AXIS)
    p = np.array([*xy, T_world_body[2, 3]]) - R @ T_world_body[:3, 3]
    return se3.make(R, p)


def rms_acceleration(path: PoseSpline) -> float:
    """Root mean square of |acceleration| over the path, m/s²."""
    times = np.arange(path.start_ns, path.end_ns + 1, round(0.1e9 * _STEP_S), dtype=np.int64)
    return float(np.sqrt(np.mean(np.sum(path.acceleration(times) ** 2, axis=-1))))


def _piece(path: Path, whole: Trajectory, start_s: float, duration_s: float | None) -> Trajectory:
    """The poses that cover the wanted piece and its margins; time 0 is the end of the first one."""
    times = whole.timestamp_ns
    first = times[0] + round(1e9 * start_s)
    if duration_s is None:
        last = times[-1]
    else:
        last = first + round(1e9 * (duration_s + 2.0 * MARGIN_S))
    if start_s < 0.0 or last > times[-1] or last - first <= 2e9 * MARGIN_S:
        length = ns_to_seconds(int(times[-1] - times[0]))
        problem = f"{length} s long; a path from {start_s:g} s on"
        if duration_s is not None:
            problem += f" and {duration_s:g} s long"
        remedy = f"it needs {MARGIN_S:g} s more at both ends; choose a shorter piece"
        raise InputError.at(path, f"{problem} is not in it", remedy)
    begin = int(np.searchsorted(times, first, side="right")) - 1
    end = int(np.searchsorted(times, last, side="left")) + 1
    if end - begin < _LEAST_POSES:
        raise InputError.at(path, f"only {end - begin} poses for this piece", "choose a longer one")
    zero = first + round(1e9 * MARGIN_S)
    return Trajectory(times[begin:end] - zero, whole.T_world_imu[begin:end])


def _refuse_gaps(path: Path, timestamp_ns: IntArray, start_s: float, max_gap_s: float) -> None:
    gaps_s = 1e-9 * np.diff(timestamp_ns)
    worst = int(np.argmax(gaps_s))
    if gaps_s[worst] > max_gap_s:
        after_s = start_s + MARGIN_S + 1e-9 * timestamp_ns[worst]
        problem = f"no pose for {gaps_s[worst]:.3f} s, {after_s:.2f} s after the first one"
        remedy = f"choose a piece without this hole, or allow gaps longer than {max_gap_s:g} s"
        raise InputError.at(path, problem, remedy)


def _smoothed(poses: Trajectory, cutoff_hz: float) -> PoseSpline:
    """The path through the smoothed poses on a uniform grid, up to a step beyond the last.

    Quaternions of one sign are smoothed as vectors and brought back to unit length: for the small
    turns within one cut-off period that is the rotations' mean (F. Markley et al., "Averaging
    Quaternions", JGCD 2007).
    """
    since_ns = poses.timestamp_ns - poses.timestamp_ns[0]
    q = so3.to_quaternion(poses.T_world_imu[:, :3, :3])
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0.0
    q *= np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))[:, None]
    pq = np.concatenate([poses.T_world_imu[:, :3, 3], q], axis=-1)
    spline = low_pass(1e-9 * since_ns, pq, cutoff_hz, _STEP_S)
    step_ns = round(1e9 * _STEP_S)
    grid_ns = np.arange(0, int(since_ns[-1]) + step_ns, step_ns, dtype=np.int64)
    values = spline(1e-9 * grid_ns)
    R = so3.from_quaternion(values[:, 3:] / np.linalg.norm(values[:, 3:], axis=-1, keepdims=True))
    return PoseSpline.through(poses.timestamp_ns[0] + grid_ns, se3.make(R, values[:, :3]))
