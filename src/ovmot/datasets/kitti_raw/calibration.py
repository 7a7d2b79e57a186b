"""Calibration of KITTI raw: three files for a date, the rectified and the unrectified cameras."""

from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import Calibration, CalibrationNode, make_rig
from ovmot.datasets.kitti.calibration import read_keyed_numbers, rectified_camera, rigid_part
from ovmot.errors import CalibrationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray

CAMERAS_FILE, VELO_FILE, IMU_FILE = (
    "calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt",
)  # fmt: skip


def read_kitti_raw_calibration(
    folder: Path, left: int, size: tuple[int, int], rectified: bool | None
) -> Calibration:
    """Rig of the cameras `left` and `left` + 1 of a date's folder, for images of `size`.

    Rectified cameras are P_rect, turned by R_rect_00; unrectified ones K and D, placed by R and T
    (camera 0 into camera i). With `rectified` None the image size tells which they are. The chain
    to the IMU goes by the velodyne. Raises `CalibrationError` with file, key and remedy.
    """
    cameras = read_keyed_numbers(folder / CAMERAS_FILE)
    T_cam0_imu = _transform(folder / VELO_FILE) @ _transform(folder / IMU_FILE)
    if rectified is None:
        rectified = size == _size(cameras, f"S_rect_{left:02d}")
    numbers = left, left + 1
    for number in numbers:
        _check_size(cameras, f"{'S_rect' if rectified else 'S'}_{number:02d}", size)
    pairs = [(_rectified if rectified else _unrectified)(cameras, n, size) for n in numbers]
    T_imu_cam0 = se3.inverse(T_cam0_imu)
    poses = [T_imu_cam0 @ T_cam0_cam for _, T_cam0_cam in pairs]
    rig = make_rig(cameras.path, (pairs[0][0], pairs[1][0]), (poses[0], poses[1]))
    return Calibration(rig, None)


def _rectified(
    node: CalibrationNode, number: int, size: tuple[int, int]
) -> tuple[Camera, FloatArray]:
    """A rectified camera and its pose T_cam0_rect on the unrectified camera 0."""
    camera, T_rect_cam = rectified_camera(node, f"P_rect_{number:02d}", size)
    R_rect_cam0 = node.numbers("R_rect_00", (3, 3))
    turn = rigid_part(node, "R_rect_00", np.column_stack([R_rect_cam0, np.zeros(3)]))
    return camera, se3.inverse(turn) @ T_rect_cam


def _unrectified(
    node: CalibrationNode, number: int, size: tuple[int, int]
) -> tuple[Camera, FloatArray]:
    """An unrectified camera and its pose T_cam0_cam on camera 0."""
    K = node.numbers(f"K_{number:02d}", (3, 3))
    D = node.numbers(f"D_{number:02d}", (5,))
    try:
        camera = Camera.make(
            size, (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), "radtan", D, skew=K[0, 1]
        )
    except CalibrationError as error:
        raise node.fail(f"K_{number:02d}", str(error)) from None
    R_key = f"R_{number:02d}"
    T = np.column_stack([node.numbers(R_key, (3, 3)), node.numbers(f"T_{number:02d}", (3,))])
    return camera, se3.inverse(rigid_part(node, R_key, T))


def _transform(path: Path) -> FloatArray:
    """The rigid motion (4, 4) of a file with `R:` and `T:`."""
    node = read_keyed_numbers(path)
    return rigid_part(
        node, "R", np.column_stack([node.numbers("R", (3, 3)), node.numbers("T", (3,))])
    )


def _size(node: CalibrationNode, key: str) -> tuple[int, int]:
    width, height = node.numbers(key, (2,))
    return int(width), int(height)


def _check_size(node: CalibrationNode, key: str, size: tuple[int, int]) -> None:
    stated = _size(node, key)
    if stated != size:
        problem = f"{stated[0]}x{stated[1]}, but the images are {size[0]}x{size[1]}"
        raise node.fail(key, problem, "give the calibration of this date, _sync or _extract")
