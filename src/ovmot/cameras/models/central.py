"""What the closed-form wide-angle models share: m = (x, y) / D, where D depends on x² + y².

D is the denominator of the projection of the ray (x, y, 1), and m a point of the image plane.
"""

import numpy as np

from ovmot.geometry.arrays import FloatArray

_STEEPEST = 1e-6  # cosine of the widest ray: that of `equidistant`, as wide as the plane goes


def quotient(xy: FloatArray, D: FloatArray) -> FloatArray:
    """m (..., 2) of points (..., 2) and denominators (...)."""
    m: FloatArray = xy / D[..., None]
    return m


def quotient_jacobian(
    xy: FloatArray, D: FloatArray, slope: FloatArray, by_coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of m by xy (..., 2, 2) and by the k coefficients of D (..., 2, k).

    `slope` (...): ∂D/∂(x² + y²); `by_coefficients` (..., k): ∂D/∂coefficients.
    """
    per_square = xy / (D * D)[..., None]
    J = np.eye(2) / D[..., None, None]
    J = J - (2.0 * slope)[..., None, None] * per_square[..., :, None] * xy[..., None, :]
    return J, -per_square[..., :, None] * by_coefficients[..., None, :]


def from_plane(m: FloatArray, m_z: FloatArray) -> FloatArray:
    """Normalized coordinates (..., 2) of rays (m, m_z), m (..., 2); NaN where they are at a right
    angle to the axis or behind."""
    with np.errstate(invalid="ignore"):
        ahead = m_z > _STEEPEST * np.sqrt((m * m).sum(-1) + m_z * m_z)
    z = np.where(ahead, m_z, np.nan)
    xy: FloatArray = m / z[..., None]
    return xy
