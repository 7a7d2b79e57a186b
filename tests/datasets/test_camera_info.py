"""Cameras by the keys of `camera_info` files: intrinsics, and the right camera's pose."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.datasets.calibration import CalibrationNode
from ovmot.datasets.camera_info import read_camera, right_from_left
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

K = np.array([[400.0, 0.0, 320.0], [0.0, 390.0, 240.0], [0.0, 0.0, 1.0]])
D = [-0.1, 0.02, 1e-3, -5e-4, 0.0]


def info(R: Any, P: Any, **changes: Any) -> CalibrationNode:
    data = {
        "image_width": 640, "image_height": 480, "camera_matrix": K.tolist(),
        "distortion_model": "plumb_bob", "distortion_coefficients": D,
        "rectification_matrix": np.asarray(R).tolist(), "projection_matrix": np.asarray(P).tolist(),
    }  # fmt: skip
    return CalibrationNode(Path("left.yaml"), "", {**data, **changes})


def test_the_right_camera_follows_from_opencv_s_rectification() -> None:
    T_cam1_cam0 = se3.exp(np.array([0.01, -0.02, 0.03, -0.3, 0.004, -0.002]))
    R, t = T_cam1_cam0[:3, :3].copy(), T_cam1_cam0[:3, 3].copy()
    R0, R1, P0, P1, *_ = cv2.stereoRectify(K, np.array(D), K, np.array(D), (640, 480), R, t)
    found = right_from_left(info(R0, P0), info(R1, P1))
    np.testing.assert_allclose(found, T_cam1_cam0, atol=1e-9)
    with pytest.raises(CalibrationError, match="of the left camera must be 0"):
        right_from_left(info(R1, P1), info(R0, P0))


def test_intrinsics_and_distortion() -> None:
    P = np.column_stack([K, np.zeros(3)])
    camera = read_camera(info(np.eye(3), P))
    assert camera.intrinsics.tolist() == [400.0, 390.0, 320.0, 240.0, 0.0]
    assert (camera.model.name, camera.distortion.tolist()) == ("radtan", D)
    for changes in ({"image_width": 0}, {"camera_matrix": (-K).tolist()}):
        with pytest.raises(CalibrationError, match=r"left\.yaml: '(image_width|camera_matrix)'"):
            read_camera(info(np.eye(3), P, **changes))
