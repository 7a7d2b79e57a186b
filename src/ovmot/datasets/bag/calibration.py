"""The rig of a bag: a Kalibr chain, or CameraInfo and a chain that mounts the left camera.

CameraInfo has both cameras and, by the right one's P, the baseline; no message says where the
cameras are on the IMU.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ovmot.datasets.bag.file import Bag
from ovmot.datasets.bag.topics import FoundTopics
from ovmot.datasets.calibration import Calibration, CalibrationNode, make_rig
from ovmot.datasets.camera_info import read_camera, right_from_left
from ovmot.datasets.kalibr import is_mount, read_kalibr, read_kalibr_mount
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

_INFO_TYPE = "sensor_msgs/CameraInfo"
_MOUNT = "--calibration FILE with cam0.T_cam_imu (and timeshift_cam_imu)"
_CHAIN = "give a Kalibr chain of both cameras with --calibration FILE"


def bag_calibration(
    bag: Bag, topics: FoundTopics, chain: Path | Calibration | None, need_imu_pose: bool = True
) -> Calibration:
    """The calibration from `chain`; what it leaves out (both cameras) from CameraInfo.

    A `chain` that is a calibration already is all. Raises `CalibrationError` that says what is
    missing.
    """
    if isinstance(chain, Calibration):
        return chain
    if chain is not None and not is_mount(chain):
        return read_kalibr(chain, need_imu_pose)
    nodes = [_info(bag, topic) for topic in (topics.left, topics.right)]
    names = [t for t, node in zip((topics.left, topics.right), nodes, strict=True) if node is None]
    if names:
        problem = f"no calibration: no CameraInfo beside {' and '.join(names)}"
        raise CalibrationError.at(bag.path, problem, _CHAIN)
    if chain is None:
        problem = "CameraInfo has the cameras, but not where they are on the IMU"
        raise CalibrationError.at(bag.path, problem, f"give {_MOUNT}")
    left, right = (node for node in nodes if node is not None)
    mount = read_kalibr_mount(chain)
    cameras = read_camera(left), read_camera(right)
    T_cam1_cam0 = right_from_left(left, right)
    if np.linalg.norm(T_cam1_cam0[:3, 3]) < 1e-6:
        problem = "P has no baseline: this camera was not calibrated as the right one of a pair"
        raise right.fail("projection_matrix", problem, _CHAIN)
    T_imu_cam1 = mount.T_imu_cam0 @ se3.inverse(T_cam1_cam0)
    rig = make_rig(bag.path, cameras, (mount.T_imu_cam0, T_imu_cam1), mount.time_offset_s)
    return Calibration(rig, mount.imu_noise)


def _info(bag: Bag, image_topic: str) -> CalibrationNode | None:
    """The first CameraInfo in the namespace of an image, or the one above (`.../compressed`)."""
    parts = image_topic.split("/")
    for depth in (1, 2):
        topic = "/".join([*parts[:-depth], "camera_info"])
        if bag.types.get(topic) == _INFO_TYPE:
            message = next(bag.messages([topic]), None)
            if message is not None:
                return _node(bag.path, topic, message.value, "rect" in image_topic)
    return None


def _node(path: Path, topic: str, info: Any, rectified: bool) -> CalibrationNode:
    """The message by the keys of `camera_info` files; rectified images see through P alone."""
    D, K, R, P = (_matrix(info, name) for name in "DKRP")
    P = P.reshape(3, 4)
    if rectified:
        D, K, R = np.empty(0), P[:, :3], np.eye(3)
    model = info.distortion_model if np.any(D) else "none"
    data = {
        "image_width": info.width,
        "image_height": info.height,
        "distortion_model": model,
        "distortion_coefficients": D.tolist(),
        "camera_matrix": K.reshape(3, 3).tolist(),
        "rectification_matrix": R.reshape(3, 3).tolist(),
        "projection_matrix": P.tolist(),
    }
    return CalibrationNode(path, topic, data)


def _matrix(info: Any, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """ROS 1 calls it `K`, ROS 2 `k`."""
    value = getattr(info, name) if hasattr(info, name) else getattr(info, name.lower())
    return np.array(value, dtype=np.float64)
