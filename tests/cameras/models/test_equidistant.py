"""The equidistant model: OpenCV's values, and its fold."""

import cv2
import numpy as np
import pytest

from ovmot.cameras.models import CAMERA_MODELS
from ovmot.geometry.arrays import FloatArray

# name, coefficients as real calibrations have them, half width of the plane they are meant for
CASES = {
    "none": ("none", [], 1.5),
    "radtan, EuRoC cam0": ("radtan", [-0.28340811, 0.07395907, 1.9359e-4, 1.76187114e-05], 0.75),
    "radtan, KAIST left": ("radtan", [-5.6e-2, 8.7e-2, -2.1e-4, 4.5e-4, -3.2e-2], 0.8),
    "radtan, pincushion": ("radtan", [0.12, 0.03, -1e-3, 2e-3, 0.01], 1.0),
    "equidistant": ("equidistant", [-0.0072, 0.0065, -0.0101, 0.0032], 1.5),
    "equidistant, plain": ("equidistant", [0.0, 0.0, 0.0, 0.0], 5.0),
}


def plane_points(shape: tuple[int, ...], half_width: float) -> FloatArray:
    return np.random.default_rng(1).uniform(-half_width, half_width, size=(*shape, 2))


def test_equidistant_agrees_with_opencv() -> None:
    _, k, half_width = CASES["equidistant"]
    xy = plane_points((50,), half_width)
    points = np.column_stack([xy, np.ones(50)])[:, None]
    theirs, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(k))
    ours = CAMERA_MODELS["equidistant"].distort(xy, np.array(k))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-12)


def test_equidistant_never_answers_from_behind_its_fold() -> None:
    k = np.array([-0.3, 0.0, 0.0, 0.0])  # θ (1 - 0.3 θ²) is largest at θ² = 1/0.9: 0.7027
    radius = np.array([[0.70, 0.0], [0.71, 0.0], [1.5, 0.0]])
    found = CAMERA_MODELS["equidistant"].undistort(radius, k)[:, 0]
    assert np.arctan(found[0]) == pytest.approx(1.0)
    assert np.all(np.isnan(found[1:]))


def test_equidistant_has_no_point_at_a_right_angle_or_past_it() -> None:
    k = np.zeros(4)
    r = np.array([[1.57, 0.0], [0.5 * np.pi, 0.0], [1.8, 0.0]])
    found = CAMERA_MODELS["equidistant"].undistort(r, k)[:, 0]
    assert found[0] == pytest.approx(np.tan(1.57), rel=1e-9)
    assert np.all(np.isnan(found[1:]))
