"""Calibration files of VINS-Fusion: one for the rig, and one for each camera beside it."""

from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import (
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
    make_rig,
)
from ovmot.errors import CalibrationError

_DISTORTION = ("k1", "k2", "p1", "p2")


def read_vins(path: Path) -> Calibration:
    """The rig of `body_T_cam0`, `body_T_cam1`, and of the files `cam0_calib`, `cam1_calib` name.

    `td` is t_imu - t_cam, seconds. The noise of these files belongs to a discrete solver: it is
    left out. Raises `CalibrationError` with file, key and remedy.
    """
    node = load_calibration_yaml(path)
    files = [path.with_name(str(node.value(f"cam{i}_calib"))) for i in (0, 1)]
    left, right = (_camera(load_calibration_yaml(file)) for file in files)
    poses = node.transform("body_T_cam0"), node.transform("body_T_cam1")
    offset_s = node.number("td") if node.has("td") else 0.0
    return Calibration(make_rig(path, (left, right), poses, offset_s), None)


def _camera(node: CalibrationNode) -> Camera:
    model = str(node.data.get("model_type", "PINHOLE"))
    if model != "PINHOLE":
        raise node.fail("model_type", f"'{model}' is not known", "calibrate with 'PINHOLE'")
    size = int(node.number("image_width")), int(node.number("image_height"))
    distortion = node.child("distortion_parameters")
    projection = node.child("projection_parameters")
    fx, fy, cx, cy = (projection.number(key) for key in ("fx", "fy", "cx", "cy"))
    coefficients = np.array([distortion.number(key) for key in _DISTORTION])
    try:
        return Camera.make(size, (fx, fy), (cx, cy), "radtan", coefficients)
    except CalibrationError as error:
        raise node.fail("projection_parameters", str(error)) from None
