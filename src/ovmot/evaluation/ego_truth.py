"""The true motion of the rig, from the files that data sets bring it in."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.datasets.pose_files import (
    column_count,
    read_euroc_ground_truth,
    read_stamped_csv,
    read_tum,
)
from ovmot.errors import InputError
from ovmot.geometry.arrays import FloatArray, IntArray

_EUROC = "state_groundtruth_estimate0"
TRUTH_FILES = (
    f"mav0/{_EUROC}/data.csv",
    f"mav0/{_EUROC}/trajectory.tum",
    "truth/poses.csv",
    f"{_EUROC}/data.csv",
    f"{_EUROC}/trajectory.tum",
)
"""Where in a data set's folder the truth may be; the first one that is there is taken.

EuRoC's comes first, because it may hold velocity and biases too."""


@dataclass(frozen=True, slots=True)
class EgoTruth:
    """True poses `T_world_imu` (N, 4, 4) at rising stamps (N,), in a world with z up.

    `velocity` (N, 3) in m/s in the world, `gyro_bias` (N, 3) in rad/s and `accel_bias` (N, 3) in
    m/s², where the file has them. `path` is that file.
    """

    path: Path
    timestamp_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray | None = None
    gyro_bias: FloatArray | None = None
    accel_bias: FloatArray | None = None


def read_ego_truth(data: Path) -> EgoTruth:
    """The truth of a data set's folder, or of a file itself: TUM, or `.csv` as EuRoC writes it.

    Raises `InputError` where there is none, or a row of it cannot be used.
    """
    path = data if data.is_file() else _find(data)
    if path.suffix != ".csv":
        trajectory = read_tum(path)
        return EgoTruth(path, trajectory.timestamp_ns, trajectory.T_world_imu)
    n_columns = column_count(path, ",")
    if n_columns == 0:
        raise InputError.at(path, "holds no data", "give a file with true poses")
    trajectory = read_euroc_ground_truth(path)
    stamps, T = trajectory.timestamp_ns, trajectory.T_world_imu
    if n_columns != 17:
        return EgoTruth(path, stamps, T)
    table = read_stamped_csv(path, 17)
    _, fresh = np.unique(table.timestamp_ns, return_index=True)  # equal stamps keep the first
    rest = table.values[fresh, 7:]
    return EgoTruth(path, stamps, T, rest[:, :3], rest[:, 3:6], rest[:, 6:])


def _find(data: Path) -> Path:
    if not data.exists():
        raise InputError.at(data, "no such file or folder", "give the truth by --truth")
    for name in TRUTH_FILES:
        if (data / name).is_file():
            return data / name
    known = ", ".join(TRUTH_FILES[:3])
    raise InputError.at(data, f"holds no true poses (looked for {known})", "give a TUM file")
