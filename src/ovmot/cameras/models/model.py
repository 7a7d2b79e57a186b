"""What a camera model is, and what the models share."""

from functools import lru_cache
from typing import Protocol

import numpy as np

from ovmot.geometry.arrays import FloatArray

NEWTON_STEPS = 12
TOLERANCE = 1e-13
"""Newton's method ends when no residual of `distort` is larger, in normalized coordinates."""


class CameraModel(Protocol):
    """A distortion model; coefficients are given at each call, so that they can be estimated."""

    name: str
    n_coefficients: tuple[int, ...]

    def scale(self, coefficients: FloatArray) -> float:
        """Derivative of `distort` on the axis, the same in each direction: 1 for most models."""
        ...

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Distorted normalized coordinates (..., 2) of undistorted ones (..., 2)."""
        ...

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `distort` by xy (..., 2, 2) and by the coefficients (..., 2, k)."""
        ...

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Undistorted normalized coordinates (..., 2) of distorted ones; NaN where there are none.

        Past the radius at which a model folds back there is no point: real images do not fold. Nor
        is there one at 90 degrees from the axis or beyond, which the plane does not reach.
        """
        ...


@lru_cache(maxsize=64)
def fold_squared(radial: tuple[float, ...]) -> float:
    """r² at which r (1 + k1 r² + k2 r⁴ + ...) stops growing; infinite where it never does."""
    slope = [1.0, *((2 * i + 3) * k for i, k in enumerate(radial))]
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(real.min(initial=np.inf))
