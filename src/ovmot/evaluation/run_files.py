"""What a run says of its own motion, read back from its folder."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ovmot.datasets.pose_files import read_tum
from ovmot.errors import InputError
from ovmot.evaluation.table_files import REMEDY, read_table
from ovmot.geometry.arrays import FloatArray, IntArray

_AXES = ("x", "y", "z")
_VELOCITY = tuple(f"v{a}" for a in _AXES)
_BIASES = tuple(f"{sensor}_bias_{a}" for sensor in ("gyro", "accel") for a in _AXES)
_SIGMAS = tuple(
    f"std_{part}{a}" for part in ("rotation_", "", "v", "gyro_bias_", "accel_bias_") for a in _AXES
)
_STATE = ("rx", "ry", "rz", "x", "y", "z", "vx", "vy", "vz")
_UPPER = np.triu_indices(len(_STATE))
_COVARIANCE = tuple(f"cov_{_STATE[i]}_{_STATE[j]}" for i, j in zip(*_UPPER, strict=True))


@dataclass(frozen=True, slots=True)
class EgoRun:
    """Poses `T_world_imu` (N, 4, 4) of a run at rising stamps (N,), and what it knows with them.

    `velocity` (N, 3) in m/s in the world, `gyro_bias` and `accel_bias` (N, 3); `sigma` (N, 15)
    over rotation (right perturbation), position, velocity and the two biases; `covariance`
    (N, 9, 9) over rotation, position, velocity. None where the run lacks the file, NaN in a row
    that lacks a value.
    """

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray | None = None
    gyro_bias: FloatArray | None = None
    accel_bias: FloatArray | None = None
    sigma: FloatArray | None = None
    covariance: FloatArray | None = None


def read_ego_run(run: Path) -> EgoRun:
    """The poses of a run's folder, with `state.csv` and `covariance.csv` where they are there.

    Raises `InputError` for a folder that is no run and for files that cannot be used.
    """
    path = run / "trajectory.tum"
    if not run.is_dir():
        problem = "is not a folder" if run.exists() else "no such folder"
        raise InputError.at(run, problem, "give the output folder of 'ovmot run'")
    if not path.is_file():
        raise InputError.at(
            run, "is not a run: it holds no trajectory.tum", "give the output folder of 'ovmot run'"
        )
    trajectory = read_tum(path)
    stamps = trajectory.timestamp_ns
    state = _columns_at(run / "state.csv", (*_VELOCITY, *_BIASES, *_SIGMAS), stamps)
    upper = _columns_at(run / "covariance.csv", _COVARIANCE, stamps)
    poses = EgoRun(stamps, trajectory.T_world_imu)
    if state is not None:
        velocity, gyro_bias, accel_bias, sigma = np.split(state, (3, 6, 9), axis=1)
        poses = EgoRun(stamps, trajectory.T_world_imu, velocity, gyro_bias, accel_bias, sigma)
    if upper is None:
        return poses
    return replace(poses, covariance=_symmetric(upper))


def _symmetric(upper: FloatArray) -> FloatArray:
    """Matrices (N, 9, 9) of their upper triangles (N, 45), row by row."""
    matrix = np.empty((len(upper), len(_STATE), len(_STATE)))
    i, j = _UPPER
    matrix[:, i, j] = upper
    matrix[:, j, i] = upper
    return matrix


def _columns_at(path: Path, columns: tuple[str, ...], stamps: IntArray) -> FloatArray | None:
    """Columns (N, K) of a table at the stamps (N,), NaN where it has no such row.

    None where there is no such file. Raises `InputError` for a table without these columns,
    with a row that is broken, or with none of the stamps.
    """
    if not path.is_file():
        return None
    table = read_table(path, columns)
    row_of = {stamp: row for row, stamp in enumerate(table.timestamp_ns.tolist())}
    rows = np.array([row_of.get(stamp, -1) for stamp in stamps.tolist()], dtype=np.int64)
    if np.all(rows < 0):
        raise InputError.at(path, "has no row for any stamp of trajectory.tum", REMEDY)
    out = np.full((len(stamps), len(columns)), np.nan)
    out[rows >= 0] = table.values[rows[rows >= 0]]
    return out
