"""True poses of KAIST Complex Urban: `global_pose.csv`, ns and T_utm_vehicle as a 3x4 matrix."""

from pathlib import Path

import numpy as np

from ovmot.datasets.kaist.calibration import imu_on_vehicle
from ovmot.datasets.text_tables import read_stamped_csv
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import DatasetError
from ovmot.geometry import se3, so3


def kaist_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The IMU's poses, from where the first one is; None without the file.

    Raises `DatasetError` with the row for what is no pose.
    """
    path = root / "global_pose.csv"
    if not path.is_file():
        return None
    table = read_stamped_csv(path, 13)
    matrix = table.values.reshape(-1, 3, 4)
    R = matrix[:, :, :3]
    wrong = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(1, 2)) > 1e-2
    if np.any(wrong):
        row = int(table.row[int(np.argmax(wrong))])
        raise DatasetError.at(path, "not a rotation", "copy the file again", row=row)
    position = matrix[:, :, 3] - matrix[0, :, 3]  # before rounding tells: UTM is 1e6 m
    T_world_vehicle = se3.make(so3.project_to_rotation(R), position)
    _, fresh = np.unique(table.timestamp_ns, return_index=True)
    T_world_imu = T_world_vehicle[fresh] @ imu_on_vehicle(root / "calibration")
    return EgoTruth(path, table.timestamp_ns[fresh], T_world_imu)
