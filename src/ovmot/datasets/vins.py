"""Calibration files of VINS-Mono and VINS-Fusion, with the camera models of camodocal.

VINS-Mono has one camera in the file of the rig, VINS-Fusion a file for each camera beside it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import (
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
    make_rig,
)
from ovmot.datasets.camera_info import rotation
from ovmot.errors import CalibrationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray

_RADTAN = ("k1", "k2", "p1", "p2")
_EQUIDISTANT = ("k2", "k3", "k4", "k5")  # camodocal's k1 is the factor 1 of the angle itself
MODELS = {
    "PINHOLE": ("radtan", (), _RADTAN, ("fx", "fy", "cx", "cy")),
    "MEI": ("omni", ("xi",), _RADTAN, ("gamma1", "gamma2", "u0", "v0")),
    "KANNALA_BRANDT": ("equidistant", (), _EQUIDISTANT, ("mu", "mv", "u0", "v0")),
}
"""Of each `model_type`: our model, and the keys below `mirror_parameters`, of its distortion, and
below `projection_parameters`."""


def is_vins(data: Mapping[str, Any]) -> bool:
    """Are these the keys of a rig's file of VINS?"""
    return "body_T_cam0" in data or "cam0_calib" in data or "model_type" in data


def read_vins(path: Path) -> Calibration:
    """The rig of `body_T_cam0`, `body_T_cam1`, and of the files `cam0_calib`, `cam1_calib` name;
    with `num_of_cam: 1`, or a camera in the file itself, that of one camera.

    `td` is t_imu - t_cam, seconds. The noise of these files belongs to a discrete solver: it is
    left out. Raises `CalibrationError` with file, key and remedy.
    """
    node = load_calibration_yaml(path)
    offset_s = node.number("td") if node.has("td") else 0.0
    if node.has("model_type"):
        rig = make_rig(path, (_camera(node),), (_mono_pose(node),), offset_s)
        return Calibration(rig, None, ("cam0",))
    one = node.has("num_of_cam") and node.number("num_of_cam") == 1
    sides = (0,) if one else (0, 1)
    files = [path.with_name(str(node.value(f"cam{i}_calib"))) for i in sides]
    cameras = [_camera(load_calibration_yaml(file)) for file in files]
    poses = [node.transform(f"body_T_cam{i}") for i in sides]
    return Calibration(
        make_rig(path, cameras, poses, offset_s), None, tuple(f"cam{i}" for i in sides)
    )


def _mono_pose(node: CalibrationNode) -> FloatArray:
    """T_imu_cam0 of VINS-Mono: `extrinsicRotation`, `extrinsicTranslation`; or as VINS-Fusion."""
    if node.has("body_T_cam0"):
        return node.transform("body_T_cam0")
    return se3.make(rotation(node, "extrinsicRotation"), node.numbers("extrinsicTranslation", (3,)))


def _camera(node: CalibrationNode) -> Camera:
    name = str(node.data.get("model_type", "PINHOLE")).upper()
    if name not in MODELS:
        raise node.fail("model_type", f"'{name}' is not known", f"known: {', '.join(MODELS)}")
    model, mirror_keys, lens_keys, projection_keys = MODELS[name]
    size = int(node.number("image_width")), int(node.number("image_height"))
    projection = node.child("projection_parameters")
    fx, fy, cx, cy = (projection.number(key) for key in projection_keys)
    # camodocal writes the coefficients of KANNALA_BRANDT beside the focal lengths
    beside = projection.has(lens_keys[0])
    lens = projection if beside else node.child("distortion_parameters")
    values = [node.child("mirror_parameters").number(key) for key in mirror_keys]
    values += [lens.number(key) for key in lens_keys]
    if mirror_keys and values[0] < 0.0:
        raise node.fail("mirror_parameters", f"xi is {values[0]:g} (at least 0)")
    try:
        return Camera.make(size, (fx, fy), (cx, cy), model, np.array(values))
    except CalibrationError as error:
        raise node.fail("projection_parameters", str(error)) from None
