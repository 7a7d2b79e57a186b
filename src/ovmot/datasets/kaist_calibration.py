"""Calibration of KAIST Complex Urban: two OpenCV files, and where sensors sit on the vehicle."""

from pathlib import Path

import numpy as np

from ovmot.cameras.calibration import (
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
    make_rig,
)
from ovmot.cameras.camera import Camera
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

# Real sequences without `Vehicle2IMU.txt` have the Xsens here (the data set's own description).
T_VEHICLE_IMU_DEFAULT: FloatArray = se3.make(np.eye(3), np.array([-0.07, 0.0, 1.7]))


def read_kaist_calibration(folder: Path) -> Calibration:
    """Rig of `left.yaml`, `right.yaml`, `Vehicle2Stereo.txt` and, if there, `Vehicle2IMU.txt`.

    The right camera follows from rectification: with p_rect = R p_cam for both cameras and the
    rectified right one displaced by K⁻¹ P[:, 3], T_cam1_cam0 = (R_rightᵀ R_left, R_rightᵀ K⁻¹ P).
    Raises `CalibrationError` with file, key and remedy. The IMU's noise is not in these files.
    """
    left = load_calibration_yaml(folder / "left.yaml")
    right = load_calibration_yaml(folder / "right.yaml")
    T_vehicle_cam0 = read_vehicle_transform(folder / "Vehicle2Stereo.txt")
    imu_file = folder / "Vehicle2IMU.txt"
    T_vehicle_imu = read_vehicle_transform(imu_file) if imu_file.exists() else T_VEHICLE_IMU_DEFAULT
    T_imu_cam0 = se3.inverse(T_vehicle_imu) @ T_vehicle_cam0
    T_imu_cam1 = T_imu_cam0 @ se3.inverse(_right_from_left(left, right))
    cameras = _camera(left), _camera(right)
    return Calibration(make_rig(right.path, cameras, (T_imu_cam0, T_imu_cam1)), None)


def read_vehicle_transform(path: Path) -> FloatArray:
    """T_vehicle_sensor (4, 4) of a text file with lines `R:` (9 numbers) and `T:` (3)."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such calibration file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text: {error}") from None
    pairs = (line.partition(":") for line in lines)
    node = CalibrationNode(
        path, "", {key.strip(): rest.split() for key, colon, rest in pairs if colon}
    )
    return se3.make(_rotation(node, "R"), node.numbers("T", (3,)))


def _right_from_left(left: CalibrationNode, right: CalibrationNode) -> FloatArray:
    """T_cam1_cam0 of the unrectified cameras."""
    R_left, R_right = (_rotation(node, "rectification_matrix") for node in (left, right))
    P_left, P_right = (node.numbers("projection_matrix", (3, 4)) for node in (left, right))
    if min(P_right[0, 0], P_right[1, 1], P_right[2, 2]) <= 0.0:
        raise right.fail("projection_matrix", "its focal lengths are not positive")
    if np.abs(P_left[:, 3]).max() > 1e-6:
        raise left.fail("projection_matrix", "the last column of the left camera must be 0")
    t_rect = np.linalg.solve(P_right[:, :3], P_right[:, 3])
    return se3.make(R_right.T @ R_left, R_right.T @ t_rect)


def _rotation(node: CalibrationNode, key: str) -> FloatArray:
    R = node.numbers(key, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise node.fail(key, "not a rotation matrix")
    return so3.project_to_rotation(R)


def _camera(node: CalibrationNode) -> Camera:
    size = int(node.number("image_width")), int(node.number("image_height"))
    if min(size) <= 0:
        raise node.fail("image_width", f"no image is {size[0]}x{size[1]} pixels")
    K = node.numbers("camera_matrix", (3, 3))
    if min(K[0, 0], K[1, 1]) <= 0.0:
        raise node.fail("camera_matrix", f"focal lengths {K[0, 0]:g}, {K[1, 1]:g} are not positive")
    lens = node.lens("distortion_model")
    coefficients = node.coefficients("distortion_coefficients")
    focal, center = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
    try:
        return Camera.make(size, focal, center, lens, coefficients, skew=K[0, 1])
    except CalibrationError as error:
        raise node.fail("distortion_coefficients", str(error)) from None
