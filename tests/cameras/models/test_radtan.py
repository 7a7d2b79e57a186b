"""The radial-tangential model: OpenCV's values, and its fold."""

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


@pytest.mark.parametrize("case", ["radtan, EuRoC cam0", "radtan, KAIST left"])
def test_radtan_agrees_with_opencv(case: str) -> None:
    _, k, half_width = CASES[case]
    xy = plane_points((50,), half_width)
    points = np.column_stack([xy, np.ones(50)])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(k))
    ours = CAMERA_MODELS["radtan"].distort(xy, np.array(k))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-12)


def test_radtan_has_no_point_past_its_largest_image_radius() -> None:
    k = np.array([-0.3, 0.0, 0.0, 0.0])  # r (1 - 0.3 r²) is largest at r² = 1/0.9: 0.7027
    model = CAMERA_MODELS["radtan"]
    assert np.all(np.isfinite(model.undistort(np.array([0.70, 0.0]), k)))
    assert np.all(np.isnan(model.undistort(np.array([0.71, 0.0]), k)))


def test_radtan_never_answers_from_behind_its_fold() -> None:
    k = np.array([-0.5, 0.06, 0.0, 0.0])  # grows to r = 0.9, falls, grows again further out
    fold = np.sqrt(np.roots([5 * k[1], 3 * k[0], 1.0]).min())
    largest = fold * (1.0 + k[0] * fold**2 + k[1] * fold**4)
    radius = np.linspace(0.0, 3.0, 301)
    model = CAMERA_MODELS["radtan"]
    found = model.undistort(np.column_stack([radius, np.zeros(301)]), k)[:, 0]
    near = radius < 0.999 * largest
    assert np.all(np.isfinite(found[near]))
    assert np.all(found[near] < fold)
    assert np.all(np.isnan(found[radius > largest]))
