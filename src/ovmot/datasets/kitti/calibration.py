"""Calibration of KITTI: the projection matrices of rectified cameras, and the chain to the IMU."""

from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import Calibration, CalibrationNode, make_rig
from ovmot.datasets.pose_files import R_WORLD_CAMERA_AXES
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.text_files import read_text


def read_kitti_calibration(path: Path, left: int, size: tuple[int, int]) -> Calibration:
    """Rig of the rectified cameras `left` and `left` + 1 (0: grey, 2: colour).

    Camera i's centre in the frame of rectified camera 0 is -K⁻¹ P[:, 3] (Geiger et al., "Vision
    meets Robotics: The KITTI Dataset", IJRR 2013). Files without the chain rectified camera <-
    velodyne <- IMU (odometry) put the IMU at the left camera, with x forward, y left, z up.
    `size` is width and height in pixels. Raises `CalibrationError` with file, key and remedy.
    """
    node = read_keyed_numbers(path)
    cameras, T_rect_cam = zip(
        *(rectified_camera(node, f"P{i}", size) for i in (left, left + 1)), strict=True
    )
    T_imu_rect = _imu_from_rectified(node)
    if T_imu_rect is None:
        T_cam_rect = se3.inverse(T_rect_cam[0])
        T_imu_rect = se3.make(R_WORLD_CAMERA_AXES, np.zeros(3)) @ T_cam_rect
    poses = T_imu_rect @ T_rect_cam[0], T_imu_rect @ T_rect_cam[1]
    return Calibration(make_rig(path, (cameras[0], cameras[1]), poses), None)


def read_keyed_numbers(path: Path) -> CalibrationNode:
    """Lines `key: numbers`; tracking writes some keys without the colon."""
    lines = read_text(path, CalibrationError, "no such calibration file").splitlines()
    fields = (line.split() for line in lines if line.strip())
    return CalibrationNode(path, "", {f[0].rstrip(":"): f[1:] for f in fields})


def rectified_camera(
    node: CalibrationNode, key: str, size: tuple[int, int]
) -> tuple[Camera, FloatArray]:
    """A rectified camera and its pose T_rect_cam."""
    P = node.numbers(key, (3, 4))
    K = P[:, :3]
    if min(K[0, 0], K[1, 1]) <= 0.0 or np.abs(K[2] - [0.0, 0.0, 1.0]).max() > 1e-9:
        raise node.fail(key, "not a projection matrix with focal lengths above zero")
    camera = Camera.make(size, (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), skew=K[0, 1])
    return camera, se3.make(np.eye(3), np.asarray(-np.linalg.solve(K, P[:, 3]), dtype=np.float64))


def _imu_from_rectified(node: CalibrationNode) -> FloatArray | None:
    """T_imu_rect, or None where the file has no chain to the IMU."""
    names = _present(node, "R0_rect", "R_rect"), _present(node, "Tr_velo_to_cam", "Tr_velo_cam")
    imu_name = _present(node, "Tr_imu_to_velo", "Tr_imu_velo")
    if imu_name is None:
        return None
    if names[0] is None or names[1] is None:
        missing = "R0_rect" if names[0] is None else "Tr_velo_to_cam"
        raise node.fail(missing, "this key is missing beside the IMU's", "add it")
    R_rect_cam = node.numbers(names[0], (3, 3))
    T_rect_cam = rigid_part(node, names[0], np.column_stack([R_rect_cam, np.zeros(3)]))
    T_cam_velo = rigid_part(node, names[1], node.numbers(names[1], (3, 4)))
    T_velo_imu = rigid_part(node, imu_name, node.numbers(imu_name, (3, 4)))
    return se3.inverse(T_rect_cam @ T_cam_velo @ T_velo_imu)


def rigid_part(node: CalibrationNode, key: str, matrix: FloatArray) -> FloatArray:
    """The rigid motion (4, 4) of a 3x4 matrix that stands under `key`."""
    R = matrix[:, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise node.fail(key, "not a rotation matrix")
    return se3.make(so3.project_to_rotation(R), matrix[:, 3])


def _present(node: CalibrationNode, *names: str) -> str | None:
    return next((name for name in names if node.has(name)), None)
