"""The enhanced unified camera model: Kalibr's `eucm`."""

import numpy as np

from ovmot.cameras.models.central import from_plane, quotient, quotient_jacobian
from ovmot.geometry.arrays import FloatArray


class EnhancedUnified:
    """Enhanced unified model (B. Khomutenko et al., RA-L 2016): alpha, beta.

    A point is put on an ellipsoid or hyperboloid: m = (x, y) / (alpha ρ + 1 - alpha) with
    ρ = sqrt(beta (x² + y²) + 1); 0 <= alpha <= 1, beta > 0.
    """

    name = "eucm"
    n_coefficients: tuple[int, ...] = (2,)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        return quotient(xy, _denominator(xy, coefficients)[0])

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        alpha, beta = (float(c) for c in coefficients)
        square = (xy * xy).sum(-1)
        rho = np.sqrt(beta * square + 1.0)
        by_coefficients = np.stack([rho - 1.0, 0.5 * alpha * square / rho], axis=-1)
        return quotient_jacobian(xy, *_denominator(xy, coefficients), by_coefficients)

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        alpha, beta = (float(c) for c in coefficients)
        m = np.asarray(xy_distorted, dtype=np.float64)
        square = beta * (m * m).sum(-1)
        with np.errstate(invalid="ignore"):
            # the ray is (m, m_z); no ray past beta r² = 1 / (2 alpha - 1)
            root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * square)
        return from_plane(m, (1.0 - alpha**2 * square) / (alpha * root + 1.0 - alpha))


def _denominator(xy: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """D = alpha ρ + 1 - alpha and its derivative by x² + y²."""
    alpha, beta = (float(c) for c in coefficients)
    rho = np.sqrt(beta * (xy * xy).sum(-1) + 1.0)
    return alpha * rho + 1.0 - alpha, 0.5 * alpha * beta / rho
