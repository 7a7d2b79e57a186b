"""The compiled rows that a feature gives: reprojection errors and their Jacobians, view by view.

Called by kernels only. The plain NumPy twin is `msckf_features.reproject`.
"""

import math

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import part
from ovmot.kernels.stereo import transform

_IMAGE_MARGIN = 0.1  # of the image's width: a linearization this far outside still holds


@part
def _view_rows(
    lens: FloatArray, q: FloatArray, p_imu: FloatArray, T_cam_imu: FloatArray,
    R_imu_world: FloatArray, rows: FloatArray,
) -> None:  # fmt: skip
    """Jacobians of a pixel (2 rows) by the point (columns 0:3) and the clone (3:9).

    `lens` (2, 2): ∂pixel/∂(undistorted coordinates); `q`, `p_imu` (3,): the point in the camera and
    in the IMU. ∂p_imu/∂θ = [p_imu]x, ∂p_imu/∂t = -Rᵀ, ∂p_imu/∂p = Rᵀ.
    """
    g = np.empty(3)
    for i in range(2):
        x, y = lens[i, 0] / q[2], lens[i, 1] / q[2]
        z = -(q[0] * x + q[1] * y) / q[2]
        for k in range(3):
            g[k] = x * T_cam_imu[0, k] + y * T_cam_imu[1, k] + z * T_cam_imu[2, k]
        for k in range(3):
            by_point = (
                g[0] * R_imu_world[0, k] + g[1] * R_imu_world[1, k] + g[2] * R_imu_world[2, k]
            )
            rows[i, k], rows[i, 6 + k] = by_point, -by_point
        rows[i, 3] = g[1] * p_imu[2] - g[2] * p_imu[1]
        rows[i, 4] = g[2] * p_imu[0] - g[0] * p_imu[2]
        rows[i, 5] = g[0] * p_imu[1] - g[1] * p_imu[0]


@part
def feature_rows(
    p: FloatArray,
    pixels: FloatArray,
    predicted: FloatArray,
    at_first: FloatArray,
    lens: FloatArray,
    by_calibration: FloatArray,
    T_imu_world: FloatArray,
    T_cam_imu: FloatArray,
    size: FloatArray,
    sigma: float,
    rows: FloatArray,
    clone: IntArray,
) -> int:
    """Whitened rows [point | clone | residual | calibration] (m, 10 + C) and their clones; m.

    Of one feature at world point p (3,): `pixels` (K, 4), `predicted` and `at_first` (K, 2, 2),
    `lens` (K, 2, 2, 2), `by_calibration` (K, 4, C). See `msckf_features.reproject`.
    """
    m, p_imu, q = 0, np.empty(3), np.empty(3)
    for k in range(len(pixels)):
        transform(T_imu_world[k], p, p_imu)
        for c in range(2):
            u, v = at_first[k, c]
            border = -_IMAGE_MARGIN * size[c, 0]
            inside = u >= border and v >= border
            inside = inside and u <= size[c, 0] - 1.0 - border and v <= size[c, 1] - 1.0 - border
            r0 = pixels[k, 2 * c] - predicted[k, c, 0]
            r1 = pixels[k, 2 * c + 1] - predicted[k, c, 1]
            if not (inside and math.isfinite(r0) and math.isfinite(r1)):
                continue
            transform(T_cam_imu[c], p_imu, q)
            _view_rows(lens[k, c], q, p_imu, T_cam_imu[c], T_imu_world[k], rows[m : m + 2])
            rows[m, 9], rows[m + 1, 9] = r0, r1
            for i in range(2):
                clone[m + i] = k
                for j in range(by_calibration.shape[2]):
                    rows[m + i, 10 + j] = by_calibration[k, 2 * c + i, j]
                for j in range(rows.shape[1]):
                    rows[m + i, j] /= sigma
            m += 2
    return m
