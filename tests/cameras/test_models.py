"""Lens models: round trips, derivatives by differences, agreement with OpenCV."""

from collections.abc import Callable

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
SHAPES = [(), (1,), (4,), (2, 3)]

Derivative = Callable[..., FloatArray]
cases = pytest.mark.parametrize("case", CASES)


def plane_points(shape: tuple[int, ...], half_width: float) -> FloatArray:
    return np.random.default_rng(1).uniform(-half_width, half_width, size=(*shape, 2))


@cases
@pytest.mark.parametrize("shape", SHAPES)
def test_undistort_undoes_distort(case: str, shape: tuple[int, ...]) -> None:
    name, k, half_width = CASES[case]
    lens, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = plane_points(shape, half_width)
    distorted = lens.distort(xy, coefficients)
    assert distorted.shape == (*shape, 2)
    np.testing.assert_allclose(lens.undistort(distorted, coefficients), xy, atol=1e-11)


@cases
@pytest.mark.parametrize("radius", [0.0, 1e-12, 1e-9, 1e-7, 1e-4])
def test_near_the_centre_a_lens_does_nothing(case: str, radius: float) -> None:
    name, k, _ = CASES[case]
    lens, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = radius * np.array([[0.6, -0.8], [1.0, 0.0], [0.0, 0.0]])
    bound = 10.0 * radius**2 + 1e-16
    np.testing.assert_allclose(lens.distort(xy, coefficients), xy, rtol=0.0, atol=bound)
    np.testing.assert_allclose(lens.undistort(xy, coefficients), xy, rtol=0.0, atol=bound)
    J, C = lens.distort_jacobian(xy, coefficients)
    assert np.abs(J - np.eye(2)).max() <= 10.0 * radius + 1e-15
    assert np.abs(C).max(initial=0.0) <= 10.0 * radius**2


@cases
@pytest.mark.parametrize("at", [(0.0, 0.0), (1e-5, -2e-5), (0.3, -0.2), (-0.6, 0.5), (0.0, 0.7)])
def test_derivatives_by_differences(
    case: str, at: tuple[float, float], central_differences: Derivative
) -> None:
    name, k, _ = CASES[case]
    lens, coefficients, xy = CAMERA_MODELS[name], np.array(k), np.array(at)
    J, C = lens.distort_jacobian(xy, coefficients)
    by_point = central_differences(lambda p: lens.distort(p, coefficients), xy)
    np.testing.assert_allclose(J, by_point, atol=1e-9)
    assert C.shape == (2, len(k))
    if k:
        by_lens = central_differences(lambda c: lens.distort(xy, c), coefficients, step=1e-4)
        np.testing.assert_allclose(C, by_lens, atol=1e-10)


@cases
@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_of_a_batch_are_those_of_each(case: str, shape: tuple[int, ...]) -> None:
    name, k, half_width = CASES[case]
    lens, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = plane_points(shape, half_width)
    J, C = lens.distort_jacobian(xy, coefficients)
    assert J.shape == (*shape, 2, 2)
    assert C.shape == (*shape, 2, len(k))
    for index in np.ndindex(shape):
        J_one, C_one = lens.distort_jacobian(xy[index], coefficients)
        np.testing.assert_allclose(J[index], J_one, atol=1e-15)
        np.testing.assert_allclose(C[index], C_one, atol=1e-15)


@pytest.mark.parametrize("case", ["radtan, EuRoC cam0", "radtan, KAIST left"])
def test_radtan_agrees_with_opencv(case: str) -> None:
    _, k, half_width = CASES[case]
    xy = plane_points((50,), half_width)
    points = np.column_stack([xy, np.ones(50)])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(k))
    ours = CAMERA_MODELS["radtan"].distort(xy, np.array(k))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-12)


def test_equidistant_agrees_with_opencv() -> None:
    _, k, half_width = CASES["equidistant"]
    xy = plane_points((50,), half_width)
    points = np.column_stack([xy, np.ones(50)])[:, None]
    theirs, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(k))
    ours = CAMERA_MODELS["equidistant"].distort(xy, np.array(k))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-12)


def test_radtan_has_no_point_past_its_largest_image_radius() -> None:
    k = np.array([-0.3, 0.0, 0.0, 0.0])  # r (1 - 0.3 r²) is largest at r² = 1/0.9: 0.7027
    lens = CAMERA_MODELS["radtan"]
    assert np.all(np.isfinite(lens.undistort(np.array([0.70, 0.0]), k)))
    assert np.all(np.isnan(lens.undistort(np.array([0.71, 0.0]), k)))


def test_radtan_never_answers_from_behind_its_fold() -> None:
    k = np.array([-0.5, 0.06, 0.0, 0.0])  # grows to r = 0.9, falls, grows again further out
    fold = np.sqrt(np.roots([5 * k[1], 3 * k[0], 1.0]).min())
    largest = fold * (1.0 + k[0] * fold**2 + k[1] * fold**4)
    radius = np.linspace(0.0, 3.0, 301)
    lens = CAMERA_MODELS["radtan"]
    found = lens.undistort(np.column_stack([radius, np.zeros(301)]), k)[:, 0]
    near = radius < 0.999 * largest
    assert np.all(np.isfinite(found[near]))
    assert np.all(found[near] < fold)
    assert np.all(np.isnan(found[radius > largest]))


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


@cases
def test_nan_stays_with_its_own_point(case: str) -> None:
    name, k, _ = CASES[case]
    lens, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = np.array([[0.1, 0.2], [np.nan, np.nan], [-0.3, 0.1]])
    found = lens.undistort(lens.distort(xy, coefficients), coefficients)
    np.testing.assert_allclose(found, xy, atol=1e-12)
    assert lens.undistort(np.empty((0, 2)), coefficients).shape == (0, 2)
