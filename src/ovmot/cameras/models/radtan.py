"""The radial-tangential distortion of Brown and Conrady."""

import numpy as np

from ovmot.cameras.models.model import fold_squared
from ovmot.cameras.models.radtan_kernel import undistort_compiled
from ovmot.geometry.arrays import FloatArray


class RadialTangential:
    """Brown-Conrady with 2 or 3 radial terms: k1, k2, p1, p2[, k3] (OpenCV's `plumb_bob`)."""

    name = "radtan"
    n_coefficients: tuple[int, ...] = (4, 5)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0

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
        xy = np.ascontiguousarray(xy_distorted, dtype=np.float64)
        k1, k2, p1, p2, k3 = _five(coefficients)
        five, fold = np.array([k1, k2, p1, p2, k3]), fold_squared((k1, k2, k3))
        return np.asarray(undistort_compiled(xy.reshape(-1, 2), five, fold)).reshape(xy.shape)


def _five(coefficients: FloatArray) -> tuple[float, float, float, float, float]:
    k1, k2, p1, p2, *k3 = coefficients.tolist()
    return k1, k2, p1, p2, k3[0] if k3 else 0.0
