"""True poses of UZH-FPV: `groundtruth.txt`, [number,] seconds, position, quaternion x y z w."""

from pathlib import Path

from ovmot.datasets.pose_files import trajectory_of
from ovmot.datasets.text_tables import column_count, read_timed_text
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import DatasetError


def uzh_fpv_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The IMU's poses; None without the file. Raises `InputError` with the row for a bad one."""
    path = root / "groundtruth.txt"
    if not path.is_file():
        return None
    n_columns = column_count(path, None)
    if n_columns not in (8, 9):
        remedy = "8 or 9 are known: [number], seconds, position, quaternion x y z w"
        raise DatasetError.at(path, f"{n_columns} columns", remedy)
    table = read_timed_text(path, n_columns, n_columns - 8)
    poses = trajectory_of(table.path, table.timestamp_ns, table.values, table.row)
    return EgoTruth(path, poses.timestamp_ns, poses.T_world_imu)
