"""Reference poses of 4Seasons: `GNSSPoses.txt`, keyframes of visual odometry fused with GNSS.

Rows of ns, translation, quaternion x y z w, the scale from visual odometry to metres, and the
fusion's quality: the left camera's pose (P. Wenzel et al., GCPR 2020, and the data set's pages).
"""

from pathlib import Path

import numpy as np

from ovmot.datasets.four_seasons.reader import cam_from_imu
from ovmot.datasets.text_tables import column_count, read_stamped_csv
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import DatasetError
from ovmot.geometry import se3, so3

_LEAST_COLUMNS = 9


def four_seasons_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The IMU's poses in metres, None without the file; its world need not have z up.

    Raises `DatasetError` with the row for what is no pose.
    """
    path = root / "GNSSPoses.txt"
    if not path.is_file():
        return None
    n_columns = column_count(path, ",")
    if n_columns < _LEAST_COLUMNS:
        remedy = "a row is: ns, position, quaternion x y z w, scale, ..."
        raise DatasetError.at(path, f"{n_columns} columns", remedy)
    table = read_stamped_csv(path, n_columns)
    q_xyzw, scale = table.values[:, 3:7], table.values[:, 7:8]
    norm = np.linalg.norm(q_xyzw, axis=1, keepdims=True)
    if np.any(np.abs(norm - 1.0) > 0.02):
        row = int(table.row[int(np.argmax(np.abs(norm[:, 0] - 1.0)))])
        raise DatasetError.at(path, "no unit quaternion", "copy the file again", row=row)
    T_world_cam0 = se3.make(so3.from_quaternion(q_xyzw / norm), scale * table.values[:, :3])
    _, fresh = np.unique(table.timestamp_ns, return_index=True)
    return EgoTruth(path, table.timestamp_ns[fresh], T_world_cam0[fresh] @ cam_from_imu(root))
