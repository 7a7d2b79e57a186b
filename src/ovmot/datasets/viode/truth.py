"""True poses of VIODE: the topic `odometry` of its bags, unpacked beside the rest."""

from pathlib import Path

from ovmot.datasets.pose_files import read_euroc_ground_truth, read_tum
from ovmot.datasets.truth import EgoTruth

_FILES = ("mav0/odometry/data.csv", "odometry/data.csv", "odometry.csv", "odometry.txt")


def viode_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The IMU's poses in AirSim's world, whose z points down; None without such a file.

    A `.csv` is in EuRoC's form (ns, position, quaternion w x y z, ...), a `.txt` in TUM's.
    """
    path = next((root / name for name in _FILES if (root / name).is_file()), None)
    if path is None:
        return None
    poses = read_euroc_ground_truth(path) if path.suffix == ".csv" else read_tum(path)
    return EgoTruth(path, poses.timestamp_ns, poses.T_world_imu)
