"""Trajectories and poses as files: TUM, KITTI and EuRoC rows, read, written and interpolated."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ovmot.datasets.text_tables import (
    column_count,
    ns_to_seconds,
    read_lines,
    read_stamped_csv,
    seconds_to_ns,
)
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray

_NS = 1_000_000_000
MAX_POSE_GAP_S = 0.15
"""Poses farther apart than this are not interpolated."""

# Camera axes (x right, y down, z forward) in a world of x forward, y left, z up.
R_WORLD_CAMERA_AXES: FloatArray = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time, in order: stamps (N,) in ns and T_world_imu (N, 4, 4), metres."""

    timestamp_ns: IntArray
    T_world_imu: FloatArray


@dataclass(frozen=True, slots=True)
class EgoPoses:
    """The rig's pose at each of M frames: `T_world_body` (M, 4, 4), NaN where there is none.

    `body` says whose poses they are: the IMU's or the left camera's (z forward, y down). Gravity
    points along -z of the world.
    """

    timestamp_ns: IntArray
    T_world_body: FloatArray
    body: Literal["imu", "cam0"]

    @property
    def known(self) -> BoolArray:
        """Which frames (M,) have a pose."""
        return np.isfinite(self.T_world_body[:, 0, 0])


def tum_line(timestamp_ns: int, T_world_imu: FloatArray) -> str:
    """One TUM row without line end: seconds, position in metres, quaternion x y z w."""
    q = so3.to_quaternion(T_world_imu[:3, :3])
    numbers = " ".join(f"{value:.9f}" for value in (*T_world_imu[:3, 3], *q))
    return f"{ns_to_seconds(timestamp_ns)} {numbers}"


def write_tum(path: Path, timestamp_ns: IntArray, T_world_imu: FloatArray) -> None:
    """Write stamps (N,) and poses (N, 4, 4) as a TUM trajectory."""
    rows = [tum_line(int(t), T) for t, T in zip(timestamp_ns, T_world_imu, strict=True)]
    path.write_text("".join(f"{row}\n" for row in rows), encoding="utf-8")


def read_tum(path: Path) -> Trajectory:
    """A TUM trajectory: seconds, position, quaternion x y z w; equal stamps keep the first.

    Raises `InputError` for an unreadable row, stamps that run backwards or a quaternion that is
    not of unit length.
    """
    lines = read_lines(path, InputError)
    values = lines.parse(np.dtype(np.float64), 8, None)
    try:
        stamps = [seconds_to_ns(text.split(None, 1)[0]) for text in lines.text]
        timestamp_ns = np.array(stamps, dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise InputError.at(path, str(error), "stamps are decimal seconds") from None
    return _trajectory(path, timestamp_ns, values[:, 1:4], values[:, 4:8], lines.row)


def read_kitti_poses(path: Path) -> FloatArray:
    """Poses (N, 4, 4) of a file of 3x4 matrices, twelve numbers a row.

    Raises `InputError` for a row of something else.
    """
    lines = read_lines(path, InputError)
    values = lines.parse(np.dtype(np.float64), 12, None).reshape(-1, 3, 4)
    R = values[:, :, :3]
    wrong = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(1, 2)) > 1e-2
    wrong |= np.linalg.det(R) < 0.0
    if np.any(wrong):
        row = int(lines.row[int(np.argmax(wrong))])
        raise InputError.at(path, "not a rotation", "a row is a 3x4 pose matrix", row=row)
    return se3.make(so3.project_to_rotation(R), values[:, :, 3])


def write_kitti_poses(path: Path, T_world_cam0: FloatArray) -> None:
    """Write poses (N, 4, 4) as rows of twelve numbers."""
    rows = (" ".join(f"{x:.9e}" for x in T[:3].ravel()) for T in T_world_cam0)
    path.write_text("".join(f"{row}\n" for row in rows), encoding="utf-8")


def read_euroc_ground_truth(path: Path) -> Trajectory:
    """Truth of a EuRoC folder: ns, position, quaternion w x y z; further columns are left out.

    Raises `InputError` like `read_tum`.
    """
    n_columns = column_count(path, ",")
    if n_columns not in (8, 17):
        raise InputError.at(path, f"{n_columns} columns", "8 or 17 are known (EuRoC ground truth)")
    table = read_stamped_csv(path, n_columns)
    q_xyzw = table.values[:, [4, 5, 6, 3]]
    return _trajectory(path, table.timestamp_ns, table.values[:, :3], q_xyzw, table.row)


def read_ego_poses(path: Path, frame_stamps_ns: IntArray) -> EgoPoses:
    """Poses of the rig at the frames (M,) from a TUM, EuRoC (`.csv`) or KITTI (12 columns) file.

    TUM and EuRoC rows are T_world_imu; between rows at most 0.15 s apart the pose is interpolated,
    and other frames have none. KITTI rows are T_world_cam0, one a frame, whose world has the first
    camera's axes: it is turned so that x is forward, y left and z up.
    Raises `InputError` where the file is none of these, or does not fit the frames.
    """
    if path.suffix == ".csv":
        return _poses_at(path, read_euroc_ground_truth(path), frame_stamps_ns)
    n_columns = column_count(path, None)
    if n_columns == 12:
        T_world_cam0 = read_kitti_poses(path)
        if len(T_world_cam0) != len(frame_stamps_ns):
            problem = f"{len(T_world_cam0)} poses for {len(frame_stamps_ns)} frames"
            raise InputError.at(path, problem, "a KITTI pose file has one row a frame")
        T_turn = se3.make(R_WORLD_CAMERA_AXES, np.zeros(3))
        return EgoPoses(frame_stamps_ns, T_turn @ T_world_cam0, "cam0")
    if n_columns != 8:
        remedy = "8 columns (TUM) or 12 (KITTI), separated by blanks, or a .csv (EuRoC), are known"
        raise InputError.at(path, f"{n_columns} columns in the first row", remedy)
    return _poses_at(path, read_tum(path), frame_stamps_ns)


def _poses_at(path: Path, trajectory: Trajectory, frame_stamps_ns: IntArray) -> EgoPoses:
    """The poses of a trajectory at the frames; `InputError` where it has none of them."""
    ego = EgoPoses(frame_stamps_ns, interpolate_poses(trajectory, frame_stamps_ns), "imu")
    if not np.any(ego.known):
        span = [ns_to_seconds(int(t)) for t in trajectory.timestamp_ns[[0, -1]]]
        problem = f"no frame lies between its stamps {span[0]} s ... {span[1]} s"
        raise InputError.at(path, problem, "check that poses and images share one clock")
    return ego


def interpolate_poses(
    trajectory: Trajectory, timestamp_ns: IntArray, max_gap_s: float = MAX_POSE_GAP_S
) -> FloatArray:
    """Poses (M, 4, 4) at stamps (M,): SLERP and linear; NaN where the neighbours are too far."""
    known, T = trajectory.timestamp_ns, trajectory.T_world_imu
    right = np.searchsorted(known, timestamp_ns)
    after = np.minimum(right, len(known) - 1)
    exact = known[after] == timestamp_ns
    before = np.where(exact, after, np.maximum(right - 1, 0))
    gap = known[after] - known[before]
    usable = exact | ((right > 0) & (right < len(known)) & (gap <= max_gap_s * _NS))
    share = (timestamp_ns - known[before]) / np.where(gap > 0, gap, 1)
    R_before, R_after = T[before, :3, :3], T[after, :3, :3]
    turn = so3.log(np.swapaxes(R_before, -1, -2) @ R_after)
    p_before, p_after = T[before, :3, 3], T[after, :3, 3]
    R = R_before @ so3.exp(share[:, None] * turn)
    out = se3.make(R, p_before + share[:, None] * (p_after - p_before))
    out[~usable] = np.nan
    return out


def trajectory_of(
    path: Path | str, timestamp_ns: IntArray, values: FloatArray, row: IntArray
) -> Trajectory:
    """Poses of values (N, 7): position, quaternion x y z w; errors as `read_tum`."""
    return _trajectory(Path(path), timestamp_ns, values[:, :3], values[:, 3:7], row)


def _trajectory(
    path: Path, timestamp_ns: IntArray, position: FloatArray, q_xyzw: FloatArray, row: IntArray
) -> Trajectory:
    """Poses from checked columns; raises `InputError` for bad quaternions or order."""
    norm = np.linalg.norm(q_xyzw, axis=-1)
    _refuse_first(path, row, np.abs(norm - 1.0) > 0.02, "the quaternion is not of unit length")
    backwards = np.concatenate([[False], np.diff(timestamp_ns) < 0])
    _refuse_first(path, row, backwards, "the stamp lies before that of the row above")
    fresh = np.concatenate([[True], np.diff(timestamp_ns) > 0])
    R = so3.from_quaternion(q_xyzw[fresh] / norm[fresh, None])
    return Trajectory(timestamp_ns[fresh], se3.make(R, position[fresh]))


def _refuse_first(path: Path, rows: Sequence[int] | IntArray, bad: BoolArray, what: str) -> None:
    if np.any(bad):
        remedy = "correct or delete the row"
        raise InputError.at(path, what, remedy, row=int(rows[int(np.argmax(bad))]))
