"""The double sphere model: Kalibr's and Basalt's `ds`."""

import numpy as np

from ovmot.cameras.models.central import from_plane, quotient, quotient_jacobian
from ovmot.geometry.arrays import BoolArray, FloatArray


class DoubleSphere:
    """Double sphere model (V. Usenko et al., 3DV 2018): xi, alpha.

    A point is put on two unit spheres, one after the other, their centres xi apart: with
    d1 = sqrt(x² + y² + 1), e = xi d1 + 1 and d2 = sqrt(x² + y² + e²) it is
    m = (x, y) / (alpha d2 + (1 - alpha) e); -1 < xi < 1, 0 <= alpha <= 1.

    A point has an image where e > -w1 d2, with w1 = alpha / (1 - alpha) or its inverse, whichever
    is below 1: on the second sphere, so far as m grows with the angle. The region of the paper,
    z > -w2 d1, is that of the first sphere, and takes in points with a negative denominator where
    xi is strongly negative.
    """

    name = "ds"
    n_coefficients: tuple[int, ...] = (2,)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0 / (1.0 + float(coefficients[0]))

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        return quotient(xy, _denominator(xy, coefficients)[0])

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        _, alpha = (float(c) for c in coefficients)
        d1, e, d2 = _distances(xy, float(coefficients[0]))
        by_xi = d1 * (alpha * e / d2 + 1.0 - alpha)
        by_coefficients = np.stack([by_xi, d2 - e], axis=-1)
        return quotient_jacobian(xy, *_denominator(xy, coefficients), by_coefficients)

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        xi, alpha = (float(c) for c in coefficients)
        m = np.asarray(xy_distorted, dtype=np.float64)
        square = (m * m).sum(-1)
        with np.errstate(invalid="ignore"):
            # the ray is (η m, η m_z - xi); no ray past r² = 1 / (2 alpha - 1)
            root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * square)
            m_z = (1.0 - alpha**2 * square) / (alpha * root + 1.0 - alpha)
            eta = (m_z * xi + np.sqrt(m_z**2 + (1.0 - xi * xi) * square)) / (m_z**2 + square)
            xy = from_plane(m, m_z - xi / eta)
        return np.where(_is_valid(xy, xi, alpha)[..., None], xy, np.nan)


def _distances(xy: FloatArray, xi: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    square = (xy * xy).sum(-1)
    d1 = np.sqrt(square + 1.0)
    e = xi * d1 + 1.0
    return d1, e, np.sqrt(square + e * e)


def _denominator(xy: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """D = alpha d2 + (1 - alpha) e, NaN where a point has no image; its derivative by x² + y²."""
    xi, alpha = (float(c) for c in coefficients)
    d1, e, d2 = _distances(xy, xi)
    D = np.where(_is_valid(xy, xi, alpha), alpha * d2 + (1.0 - alpha) * e, np.nan)
    e_slope = 0.5 * xi / d1
    return D, alpha * (0.5 + e * e_slope) / d2 + (1.0 - alpha) * e_slope


def _is_valid(xy: FloatArray, xi: float, alpha: float) -> BoolArray:
    """Does a point have an image: is e > -w1 d2?"""
    _, e, d2 = _distances(xy, xi)
    w1 = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
    return np.asarray(e > -w1 * d2)
