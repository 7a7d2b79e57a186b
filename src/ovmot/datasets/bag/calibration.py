"""The rig of a bag: a Kalibr chain, or CameraInfo and a chain that mounts the left camera.

CameraInfo has both cameras and, by the right one's P, the baseline; no message says where the
cameras are on the IMU.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.datasets.bag.file import Bag
from ovmot.datasets.bag.topics import BagTopics, FoundTopics
from ovmot.datasets.calibration import Calibration, CalibrationNode, make_rig
from ovmot.datasets.camera_info import read_camera, right_from_left
from ovmot.datasets.given_calibration import read_calibration
from ovmot.datasets.kalibr import is_mount, read_kalibr_mount
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

_INFO_TYPE = "sensor_msgs/CameraInfo"
_MOUNT = "--calibration FILE with cam0.T_cam_imu (and timeshift_cam_imu)"
_CHAIN = (
    "give --calibration FILE: a Kalibr chain with both cameras, cam1's T_cn_cnm1 and cam0's"
    " T_cam_imu, or VINS's or OpenVINS's file; docs 'Your own data' says how to get one"
)
_WITHOUT_CAMERA = "says where the left camera is, but has no intrinsics"


def given_calibration(
    given: Path | Calibration | None, asked: BagTopics, need_imu_pose: bool = True
) -> Path | Calibration | None:
    """A file of cameras read; one that says only where the left camera is mounted stays a path.

    `asked`: which cameras of a chain, by name or topic; `need_imu_pose`: see
    `kalibr.read_kalibr_cameras`. Raises `CalibrationError`.
    """
    if isinstance(given, Path) and not is_mount(given):
        return read_calibration(given, asked.left, asked.right, need_imu_pose)
    return given


def topics_of_cameras(bag: Bag, given: Path | Calibration | None, asked: BagTopics) -> BagTopics:
    """The topics of the cameras that were asked for by their names in the chain; and, of a bag of
    more image topics than the chain has cameras, those that the chain names.

    Raises `CalibrationError` where the chain does not say the topic of a camera.
    """
    if not isinstance(given, Calibration):
        return asked
    by_camera = dict(zip(given.cameras, given.topics, strict=False))
    for name in (asked.left, asked.right):
        if name in by_camera and by_camera[name] is None:
            problem = f"the chain has no rostopic for {name}"
            raise CalibrationError.at(bag.path, problem, "name topics with --left and --right")
    asked = replace(
        asked,
        left=by_camera.get(asked.left or "", asked.left),
        right=by_camera.get(asked.right or "", asked.right),
    )
    named = [topic for topic in given.topics if topic in bag.types]
    if asked.left is None and asked.right is None and len(named) == len(given.cameras):
        return replace(asked, left=named[0], right=named[1] if len(named) > 1 else None)
    return asked


def bag_calibration(bag: Bag, topics: FoundTopics, chain: Path | Calibration | None) -> Calibration:
    """The calibration from `chain`; what it leaves out (both cameras) from CameraInfo.

    A `chain` that is a calibration already is all; of one camera more than the bag has, the left
    one is taken. Raises `CalibrationError` that says what is
    missing.
    """
    if isinstance(chain, Calibration):
        return chain.of_left_camera() if topics.right is None else chain
    nodes = [_info(bag, topic) for topic in topics.images]
    names = [t for t, node in zip(topics.images, nodes, strict=True) if node is None]
    if names:
        problem = f"no CameraInfo beside {' and '.join(names)}"
        if chain is not None:
            problem = f"{_WITHOUT_CAMERA}, and {bag.path} has {problem}"
            raise CalibrationError.at(chain, problem, _CHAIN)
        raise CalibrationError.at(bag.path, f"no calibration: {problem}", _CHAIN)
    if chain is None:
        problem = "CameraInfo has the cameras, but not where they are on the IMU"
        raise CalibrationError.at(bag.path, problem, f"give {_MOUNT}")
    mount = read_kalibr_mount(chain)
    known = [node for node in nodes if node is not None]
    if len(known) == 1:
        camera = (read_camera(known[0]),)
        rig = make_rig(bag.path, camera, (mount.T_imu_cam0,), mount.time_offset_s)
        return Calibration(rig, mount.imu_noise, ("cam0",))
    left, right = known
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
    if not np.any(K):
        problem = f"topic {topic}: K is 0: the driver publishes an empty CameraInfo"
        raise CalibrationError.at(path, problem, _CHAIN)
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
