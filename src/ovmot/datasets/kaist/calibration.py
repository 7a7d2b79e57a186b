"""Calibration of KAIST Complex Urban: two OpenCV files, and where sensors sit on the vehicle."""

from pathlib import Path

import numpy as np

from ovmot.datasets.calibration import (
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
    make_rig,
)
from ovmot.datasets.camera_info import read_camera, right_from_left, rotation
from ovmot.errors import CalibrationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.text_files import read_text

# Real sequences without `Vehicle2IMU.txt` have the Xsens here (the data set's own description).
T_VEHICLE_IMU_DEFAULT: FloatArray = se3.make(np.eye(3), np.array([-0.07, 0.0, 1.7]))


def read_kaist_calibration(folder: Path) -> Calibration:
    """Rig of `left.yaml`, `right.yaml`, `Vehicle2Stereo.txt` and, if there, `Vehicle2IMU.txt`.

    The right camera follows from rectification. Raises `CalibrationError` with file, key and
    remedy. The IMU's noise is not in these files.
    """
    left = load_calibration_yaml(folder / "left.yaml")
    right = load_calibration_yaml(folder / "right.yaml")
    T_vehicle_cam0 = read_vehicle_transform(folder / "Vehicle2Stereo.txt")
    T_imu_cam0 = se3.inverse(imu_on_vehicle(folder)) @ T_vehicle_cam0
    T_imu_cam1 = T_imu_cam0 @ se3.inverse(right_from_left(left, right))
    cameras = read_camera(left), read_camera(right)
    return Calibration(make_rig(right.path, cameras, (T_imu_cam0, T_imu_cam1)), None)


def imu_on_vehicle(folder: Path) -> FloatArray:
    """T_vehicle_imu (4, 4) of `Vehicle2IMU.txt`, if it is there, else the data set's own."""
    path = folder / "Vehicle2IMU.txt"
    return read_vehicle_transform(path) if path.exists() else T_VEHICLE_IMU_DEFAULT


def read_vehicle_transform(path: Path) -> FloatArray:
    """T_vehicle_sensor (4, 4) of a text file with lines `R:` (9 numbers) and `T:` (3)."""
    lines = read_text(path, CalibrationError, "no such calibration file").splitlines()
    pairs = (line.partition(":") for line in lines)
    node = CalibrationNode(
        path, "", {key.strip(): rest.split() for key, colon, rest in pairs if colon}
    )
    return se3.make(rotation(node, "R"), node.numbers("T", (3,)))
