"""The equidistant fisheye model of Kannala and Brandt."""

import numpy as np

from ovmot.cameras.models.model import NEWTON_STEPS, TOLERANCE, fold_squared
from ovmot.geometry.arrays import FloatArray


class Equidistant:
    """Fisheye of Kannala and Brandt (PAMI 2006), k1..k4: r = θ (1 + k1 θ² + ... + k4 θ⁸)."""

    name = "equidistant"
    n_coefficients: tuple[int, ...] = (4,)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        r = np.linalg.norm(xy, axis=-1, keepdims=True)
        theta = np.arctan(r)
        small = r < 1e-8
        scale = np.where(small, 1.0, _theta_d(theta, coefficients) / np.where(small, 1.0, r))
        return xy * scale

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = np.linalg.norm(xy, axis=-1)[..., None]
        small = r < 1e-8
        r_safe = np.where(small, 1.0, r)
        theta = np.arctan(r)
        unit = np.where(small, 0.0, xy / r_safe)
        scale = np.where(small, 1.0, _theta_d(theta, coefficients) / r_safe)
        slope = _theta_d_slope(theta, coefficients) / (1.0 + r * r)  # d(theta_d)/dr
        J = scale[..., None] * np.eye(2) + ((slope - scale)[..., None]) * (
            unit[..., :, None] * unit[..., None, :]
        )
        powers = theta ** np.array([3, 5, 7, 9])
        return J, unit[..., :, None] * powers[..., None, :]

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        xy = np.asarray(xy_distorted, dtype=np.float64)
        theta_d = np.linalg.norm(xy, axis=-1, keepdims=True)
        theta = np.minimum(theta_d, 0.5 * np.pi)
        for _ in range(NEWTON_STEPS):
            residual = _theta_d(theta, coefficients) - theta_d
            if not np.nanmax(np.abs(residual), initial=0.0) > TOLERANCE:
                break
            slope = _theta_d_slope(theta, coefficients)
            theta = theta - residual / np.where(np.abs(slope) < 1e-9, np.nan, slope)
        limit = min(0.5 * np.pi - 1e-6, fold_squared(tuple(coefficients)) ** 0.5)
        found = (np.abs(_theta_d(theta, coefficients) - theta_d) < 1e-8) & (theta >= 0.0)
        found &= theta < limit
        small = theta_d < 1e-8
        scale = np.where(small, 1.0, np.tan(theta) / np.where(small, 1.0, theta_d))
        return np.where(found, xy * scale, np.nan)


def _theta_d(theta: FloatArray, k: FloatArray) -> FloatArray:
    t2 = theta * theta
    theta_d: FloatArray = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    return theta_d


def _theta_d_slope(theta: FloatArray, k: FloatArray) -> FloatArray:
    t2 = theta * theta
    slope: FloatArray = 1.0 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    return slope
