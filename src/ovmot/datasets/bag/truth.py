"""True poses in a bag: its topic of type nav_msgs/Odometry."""

from pathlib import Path

import numpy as np

from ovmot.datasets.bag.file import Bag, BagMessage
from ovmot.datasets.pose_files import trajectory_of
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import InputError

_TYPE = "nav_msgs/Odometry"
_VIODE = "/odometry"


def bag_truth(path: Path) -> EgoTruth:
    """The poses of a bag's only odometry, or of that called `/odometry`, as poses of the IMU.

    Raises `InputError` where there is none, or several.
    """
    with Bag(path) as bag:
        topics = [topic for topic, kind in bag.types.items() if kind == _TYPE]
        chosen = [topic for topic in topics if topic == _VIODE] or topics
        if len(chosen) != 1:
            problem = f"holds {len(chosen)} topics of type {_TYPE}: {', '.join(chosen)}"
            raise InputError.at(path, problem.rstrip(": "), "give a TUM file by --truth")
        rows = [_row(message) for message in bag.messages(chosen)]
    place = f"{path}, topic {chosen[0]}"
    if not rows:
        raise InputError.at(place, "holds no messages", "give a TUM file by --truth")
    stamps = np.array([stamp for stamp, _ in rows], dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    values = np.array([pose for _, pose in rows])[order]
    poses = trajectory_of(place, stamps[order], values, order + 1)
    return EgoTruth(path, poses.timestamp_ns, poses.T_world_imu)


def _row(message: BagMessage) -> tuple[int, list[float]]:
    stamp, pose = message.value.header.stamp, message.value.pose.pose
    p, q = pose.position, pose.orientation
    time_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return time_ns, [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
