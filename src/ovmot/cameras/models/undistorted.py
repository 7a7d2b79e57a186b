"""The pinhole camera without distortion."""

import numpy as np

from ovmot.geometry.arrays import FloatArray


class Undistorted:
    """No distortion: rectified images."""

    name = "none"
    n_coefficients: tuple[int, ...] = (0,)

    def scale(self, coefficients: FloatArray) -> float:
        return 1.0

    def distort(self, xy: FloatArray, coefficients: FloatArray) -> FloatArray:
        return np.asarray(xy, dtype=np.float64)

    def distort_jacobian(
        self, xy: FloatArray, coefficients: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        shape = xy.shape[:-1]
        return np.broadcast_to(np.eye(2), (*shape, 2, 2)), np.zeros((*shape, 2, 0))

    def undistort(self, xy_distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
        return np.asarray(xy_distorted, dtype=np.float64)
