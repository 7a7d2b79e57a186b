"""Compiled rotations against `geometry.so3`."""

import numpy as np
import pytest

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.rotations import multiply, orthonormalize, right_jacobian, rotation_exp

AXIS = np.array([0.6, -0.48, 0.64])
VECTORS = [angle * AXIS for angle in (0.0, 1e-9, 9e-4, 1.1e-3, 0.3, 3.0, 3.14159)]


@pytest.mark.parametrize("v", VECTORS)
def test_exponential_and_jacobian(v: FloatArray) -> None:
    out = np.empty((3, 3))
    rotation_exp(v, out)
    np.testing.assert_allclose(out, so3.exp(v), atol=1e-15)
    right_jacobian(v, out)
    np.testing.assert_allclose(out, so3.right_jacobian(v), atol=1e-12)


def test_product() -> None:
    A, B = np.random.default_rng(1).normal(size=(2, 3, 3))
    out = np.empty((3, 3))
    multiply(A, B, out)
    np.testing.assert_allclose(out, A @ B, atol=1e-15)


@pytest.mark.parametrize("size", [1e-15, 1e-6, 1e-3])
def test_the_nearest_rotation(size: float) -> None:
    rng = np.random.default_rng(2)
    rough = so3.exp(rng.normal(size=3)) + size * rng.normal(size=(3, 3))
    R = rough.copy()
    orthonormalize(R)
    np.testing.assert_allclose(R, so3.project_to_rotation(rough), atol=100.0 * size**4 + 1e-15)
