"""Lens models: how a lens moves a point of the ideal image plane.

A lens works on normalised coordinates (x/z, y/z), without unit. A new model is one class here or
in a file of its own, and a line in `CAMERA_MODELS`.
"""

from functools import lru_cache
from typing import Protocol

import numpy as np

from ovmot.geometry.arrays import FloatArray

_NEWTON_STEPS = 12
_TOLERANCE = 1e-13


class CameraModel(Protocol):
    """A distortion model; coefficients are given at each call, so that they can be estimated."""

    name: str
    n_coefficients: tuple[int, ...]

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Distorted plane coordinates (..., 2) of ideal ones (..., 2)."""
        ...

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `distort` by xy (..., 2, 2) and by the coefficients (..., 2, k)."""
        ...

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Ideal plane coordinates (..., 2) of distorted ones; NaN where the model has none.

        Past the radius at which a model folds back no point is returned: a lens does not fold.
        """
        ...


class RadialTangential:
    """Brown-Conrady with 2 or 3 radial terms: k1, k2, p1, p2[, k3] (OpenCV's `plumb_bob`)."""

    name = "radtan"
    n_coefficients: tuple[int, ...] = (4, 5)

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        x, y = xy[..., 0], xy[..., 1]
        k1, k2, p1, p2, k3 = _five(coefficients)
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([xd, yd], axis=-1)

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        C = np.empty((*xy.shape[:-1], 2, 5))
        C[..., 0, 0], C[..., 1, 0] = x * r2, y * r2
        C[..., 0, 1], C[..., 1, 1] = x * r2**2, y * r2**2
        C[..., 0, 2], C[..., 1, 2] = 2.0 * x * y, r2 + 2.0 * y * y
        C[..., 0, 3], C[..., 1, 3] = r2 + 2.0 * x * x, 2.0 * x * y
        C[..., 0, 4], C[..., 1, 4] = x * r2**3, y * r2**3
        return self._jacobian_xy(xy, coefficients), C[..., : len(coefficients)]

    def _jacobian_xy(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        x, y = xy[..., 0], xy[..., 1]
        k1, k2, p1, p2, k3 = _five(coefficients)
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))  # d(radial)/dx = slope * x
        J = np.empty((*xy.shape[:-1], 2, 2))
        J[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        J[..., 0, 1] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        J[..., 1, 0] = J[..., 0, 1]
        J[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        return J

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        target = np.asarray(xy_distorted, dtype=np.float64)
        xy = target.copy()
        for _ in range(_NEWTON_STEPS):
            residual = self.distort(xy, coefficients) - target
            if not np.nanmax(np.abs(residual), initial=0.0) > _TOLERANCE:
                break
            J = self._jacobian_xy(xy, coefficients)
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            det = np.where(np.abs(det) < 1e-9, np.nan, det)
            step_x = (J[..., 1, 1] * residual[..., 0] - J[..., 0, 1] * residual[..., 1]) / det
            step_y = (J[..., 0, 0] * residual[..., 1] - J[..., 1, 0] * residual[..., 0]) / det
            xy = xy - np.stack([step_x, step_y], axis=-1)
        miss = np.abs(self.distort(xy, coefficients) - target).max(axis=-1, keepdims=True)
        k1, k2, _, _, k3 = _five(coefficients)
        inside = np.sum(xy * xy, axis=-1, keepdims=True) < _fold_squared((k1, k2, k3))
        return np.where((miss < 1e-8) & inside, xy, np.nan)


class Equidistant:
    """Fisheye of Kannala and Brandt (PAMI 2006), k1..k4: r = θ (1 + k1 θ² + ... + k4 θ⁸)."""

    name = "equidistant"
    n_coefficients: tuple[int, ...] = (4,)

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
        for _ in range(_NEWTON_STEPS):
            residual = _theta_d(theta, coefficients) - theta_d
            if not np.nanmax(np.abs(residual), initial=0.0) > _TOLERANCE:
                break
            slope = _theta_d_slope(theta, coefficients)
            theta = theta - residual / np.where(np.abs(slope) < 1e-9, np.nan, slope)
        limit = min(0.5 * np.pi - 1e-6, _fold_squared(tuple(coefficients)) ** 0.5)
        found = (np.abs(_theta_d(theta, coefficients) - theta_d) < 1e-8) & (theta >= 0.0)
        found &= theta < limit
        small = theta_d < 1e-8
        scale = np.where(small, 1.0, np.tan(theta) / np.where(small, 1.0, theta_d))
        return np.where(found, xy * scale, np.nan)


class Undistorted:
    """No distortion: rectified images."""

    name = "none"
    n_coefficients: tuple[int, ...] = (0,)

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        return np.asarray(xy, dtype=np.float64)

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        shape = xy.shape[:-1]
        return np.broadcast_to(np.eye(2), (*shape, 2, 2)), np.zeros((*shape, 2, 0))

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        return np.asarray(xy_distorted, dtype=np.float64)


_MODELS: tuple[CameraModel, ...] = (RadialTangential(), Equidistant(), Undistorted())
CAMERA_MODELS: dict[str, CameraModel] = {lens.name: lens for lens in _MODELS}


def _five(coefficients: FloatArray) -> tuple[float, float, float, float, float]:
    k1, k2, p1, p2 = (float(c) for c in coefficients[:4])
    return k1, k2, p1, p2, float(coefficients[4]) if len(coefficients) > 4 else 0.0


@lru_cache(maxsize=64)
def _fold_squared(radial: tuple[float, ...]) -> float:
    """r² at which r (1 + k1 r² + k2 r⁴ + ...) stops growing; infinite where it never does."""
    slope = [1.0, *((2 * i + 3) * k for i, k in enumerate(radial))]
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(real.min(initial=np.inf))


def _theta_d(theta: FloatArray, k: FloatArray) -> FloatArray:
    t2 = theta * theta
    theta_d: FloatArray = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    return theta_d


def _theta_d_slope(theta: FloatArray, k: FloatArray) -> FloatArray:
    t2 = theta * theta
    slope: FloatArray = 1.0 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    return slope
