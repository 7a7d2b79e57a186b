"""Camera models: round trips, derivatives by differences, agreement with OpenCV."""

from collections.abc import Callable

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
    "omni, a mirror": ("omni", [1.2, -0.19, 0.12, 1e-3, -7e-4], 1.5),
    "omni, sphere alone": ("omni", [2.1], 5.0),
    "omni, a pinhole": ("omni", [0.0, -0.28, 0.07, 2e-4, 2e-5], 0.75),
    "eucm, BF2M2020S23": ("eucm", [0.5704, 1.0956], 5.0),
    "eucm, a pinhole": ("eucm", [0.0, 1.0], 1.5),
    "ds, TUM-VI": ("ds", [-0.1806, 0.5930], 5.0),
    "ds, positive xi": ("ds", [0.4, 0.7], 5.0),
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
    model, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = plane_points(shape, half_width)
    distorted = model.distort(xy, coefficients)
    assert distorted.shape == (*shape, 2)
    np.testing.assert_allclose(model.undistort(distorted, coefficients), xy, atol=1e-11)


@cases
@pytest.mark.parametrize("radius", [0.0, 1e-12, 1e-9, 1e-7, 1e-4])
def test_near_the_centre_a_camera_model_is_linear(case: str, radius: float) -> None:
    name, k, _ = CASES[case]
    model, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = radius * np.array([[0.6, -0.8], [1.0, 0.0], [0.0, 0.0]])
    bound = 10.0 * radius**2 + 1e-15 * radius + 1e-16
    J0, _ = model.distort_jacobian(np.zeros(2), coefficients)
    scale = model.scale(coefficients)
    np.testing.assert_allclose(J0, scale * np.eye(2), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(model.distort(xy, coefficients), scale * xy, rtol=0.0, atol=bound)
    undistorted = model.undistort(scale * xy, coefficients)
    np.testing.assert_allclose(undistorted, xy, rtol=0.0, atol=bound)
    J, _ = model.distort_jacobian(xy, coefficients)
    assert np.abs(J - J0).max() <= 10.0 * radius + 1e-15


@cases
@pytest.mark.parametrize("at", [(0.0, 0.0), (1e-5, -2e-5), (0.3, -0.2), (-0.6, 0.5), (0.0, 0.7)])
def test_derivatives_by_differences(
    case: str, at: tuple[float, float], central_differences: Derivative
) -> None:
    name, k, _ = CASES[case]
    model, coefficients, xy = CAMERA_MODELS[name], np.array(k), np.array(at)
    J, C = model.distort_jacobian(xy, coefficients)
    by_point = central_differences(lambda p: model.distort(p, coefficients), xy)
    np.testing.assert_allclose(J, by_point, atol=1e-9)
    assert C.shape == (2, len(k))
    if k:
        by_coefficients = central_differences(
            lambda c: model.distort(xy, c), coefficients, step=1e-4
        )
        np.testing.assert_allclose(C, by_coefficients, atol=1e-10)


@cases
@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_of_a_batch_are_those_of_each(case: str, shape: tuple[int, ...]) -> None:
    name, k, half_width = CASES[case]
    model, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = plane_points(shape, half_width)
    J, C = model.distort_jacobian(xy, coefficients)
    assert J.shape == (*shape, 2, 2)
    assert C.shape == (*shape, 2, len(k))
    for index in np.ndindex(shape):
        J_one, C_one = model.distort_jacobian(xy[index], coefficients)
        np.testing.assert_allclose(J[index], J_one, atol=1e-15)
        np.testing.assert_allclose(C[index], C_one, atol=1e-15)


@cases
def test_nan_stays_with_its_own_point(case: str) -> None:
    name, k, _ = CASES[case]
    model, coefficients = CAMERA_MODELS[name], np.array(k)
    xy = np.array([[0.1, 0.2], [np.nan, np.nan], [-0.3, 0.1]])
    found = model.undistort(model.distort(xy, coefficients), coefficients)
    np.testing.assert_allclose(found, xy, atol=1e-12)
    assert model.undistort(np.empty((0, 2)), coefficients).shape == (0, 2)
