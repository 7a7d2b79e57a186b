"""Cameras by the keys of ROS's `camera_info` files, which OpenCV's and KAIST's also have.

Messages of type `sensor_msgs/CameraInfo` are the same values, see `bag_calibration`.
"""

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import CalibrationNode
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


def right_from_left(left: CalibrationNode, right: CalibrationNode) -> FloatArray:
    """T_cam1_cam0 (4, 4) of the unrectified cameras, from their rectification.

    With p_rect = R p_cam for both cameras and the rectified right one displaced by K⁻¹ P[:, 3],
    T_cam1_cam0 = (R_rightᵀ R_left, R_rightᵀ K⁻¹ P[:, 3]). Raises `CalibrationError`.
    """
    R_left, R_right = (rotation(node, "rectification_matrix") for node in (left, right))
    P_left, P_right = (node.numbers("projection_matrix", (3, 4)) for node in (left, right))
    if min(P_right[0, 0], P_right[1, 1], P_right[2, 2]) <= 0.0:
        raise right.fail("projection_matrix", "its focal lengths are not positive")
    if np.abs(P_left[:, 3]).max() > 1e-6:
        raise left.fail("projection_matrix", "the last column of the left camera must be 0")
    t_rect = np.linalg.solve(P_right[:, :3], P_right[:, 3])
    return se3.make(R_right.T @ R_left, R_right.T @ t_rect)


def rotation(node: CalibrationNode, key: str) -> FloatArray:
    """The rotation (3, 3) under a key, cleaned of rounding; raises `CalibrationError`."""
    R = node.numbers(key, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise node.fail(key, "not a rotation matrix")
    return so3.project_to_rotation(R)


def read_camera(node: CalibrationNode) -> Camera:
    """The unrectified camera; raises `CalibrationError` with the key."""
    size = int(node.number("image_width")), int(node.number("image_height"))
    if min(size) <= 0:
        raise node.fail("image_width", f"no image is {size[0]}x{size[1]} pixels")
    K = node.numbers("camera_matrix", (3, 3))
    if min(K[0, 0], K[1, 1]) <= 0.0:
        raise node.fail("camera_matrix", f"focal lengths {K[0, 0]:g}, {K[1, 1]:g} are not positive")
    model = node.camera_model("distortion_model")
    coefficients = node.coefficients("distortion_coefficients")
    focal, center = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
    try:
        return Camera.make(size, focal, center, model, coefficients, skew=K[0, 1])
    except CalibrationError as error:
        raise node.fail("distortion_coefficients", str(error)) from None
