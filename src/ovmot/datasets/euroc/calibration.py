"""Calibration files of EuRoC/ASL folders: a `sensor.yaml` beside each sensor's data."""

from pathlib import Path

from ovmot.cameras.calibration import (
    Calibration,
    load_calibration_yaml,
    make_rig,
    read_imu_noise,
    read_pinhole,
)
from ovmot.geometry import se3


def read_euroc(cam0: Path, cam1: Path, imu: Path | None) -> Calibration:
    """Rig and IMU noise of the `sensor.yaml` files of two cameras and, if there, of the IMU.

    `T_BS` maps sensor points into the body frame; without an IMU file the body is the IMU.
    Raises `CalibrationError` with file, key and remedy.
    """
    left, right = load_calibration_yaml(cam0), load_calibration_yaml(cam1)
    cameras = tuple(read_pinhole(node, "distortion_coefficients") for node in (left, right))
    T_body_cam0, T_body_cam1 = left.transform("T_BS"), right.transform("T_BS")
    if imu is None:
        return Calibration(
            make_rig(cam1, (cameras[0], cameras[1]), (T_body_cam0, T_body_cam1)), None
        )
    node = load_calibration_yaml(imu)
    T_imu_body = se3.inverse(node.transform("T_BS"))
    poses = T_imu_body @ T_body_cam0, T_imu_body @ T_body_cam1
    return Calibration(make_rig(cam1, (cameras[0], cameras[1]), poses), read_imu_noise(node))
