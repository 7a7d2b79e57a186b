"""The unified model of mirror and fisheye cameras: Kalibr's `omni`, MEI in VINS."""

import numpy as np

from ovmot.cameras.models.central import from_plane, quotient, quotient_jacobian
from ovmot.cameras.models.radtan import RadialTangential
from ovmot.geometry.arrays import FloatArray

_RADTAN = RadialTangential()


class Omni:
    """Unified model (C. Mei and P. Rives, ICRA 2007): xi[, k1, k2, p1, p2].

    A point is put on the unit sphere, seen from xi behind its centre, and distorted as by `radtan`:
    m = (x, y) / (1 + xi d) with d = sqrt(x² + y² + 1).
    """

    name = "omni"
    n_coefficients: tuple[int, ...] = (1, 5)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0 / (1.0 + float(coefficients[0]))

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        D, _ = _denominator(xy, float(coefficients[0]))
        return _RADTAN.distort(quotient(xy, D), _lens(coefficients))

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        D, slope = _denominator(xy, float(coefficients[0]))
        m = quotient(xy, D)
        d = np.sqrt((xy * xy).sum(-1) + 1.0)
        J, by_xi = quotient_jacobian(xy, D, slope, d[..., None])
        J_lens, by_lens = _RADTAN.distort_jacobian(m, _lens(coefficients))
        C = np.concatenate([J_lens @ by_xi, by_lens], axis=-1)
        return J_lens @ J, C[..., : len(coefficients)]

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        xi = float(coefficients[0])
        m = _RADTAN.undistort(xy_distorted, _lens(coefficients))
        square = (m * m).sum(-1)
        with np.errstate(invalid="ignore"):
            # the ray is (η m, η - xi); no ray past the image of the sphere's rim
            eta = (xi + np.sqrt(1.0 + (1.0 - xi * xi) * square)) / (square + 1.0)
        return from_plane(m, 1.0 - xi / eta)


def _denominator(xy: FloatArray, xi: float) -> tuple[FloatArray, FloatArray]:
    """D = 1 + xi d and its derivative by x² + y²."""
    d = np.sqrt((xy * xy).sum(-1) + 1.0)
    return 1.0 + xi * d, 0.5 * xi / d


def _lens(coefficients: FloatArray) -> FloatArray:
    return coefficients[1:] if len(coefficients) > 1 else np.zeros(4)
