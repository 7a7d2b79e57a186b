"""The compiled rows that a feature gives: reprojection errors and their Jacobians, view by view.

Called by kernels only. The plain NumPy twin is `msckf_features.reproject`.
"""

import math

import numpy as np

from ovmot.cameras.lens_kernel import pixel_jacobian, to_pixel
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import inlined_part, part, reordered_part
from ovmot.kernels.stereo import transform

IMAGE_MARGIN = 0.1  # of the image's width: a linearization this far outside still holds


@inlined_part
def _view_rows(
    lens: FloatArray, q: FloatArray, p_imu: FloatArray, T_cam_imu: FloatArray,
    R_imu_world: FloatArray, rows: FloatArray,
) -> None:  # fmt: skip
    """Jacobians of a pixel (2 rows) by the point (columns 0:3) and the clone (3:9).

    `lens` (2, 2): ∂pixel/∂(undistorted coordinates); `q`, `p_imu` (3,): the point in the camera and
    in the IMU. ∂p_imu/∂θ = [p_imu]x, ∂p_imu/∂t = -Rᵀ, ∂p_imu/∂p = Rᵀ.
    """
    T, R = T_cam_imu, R_imu_world
    for i in range(2):
        x, y = lens[i, 0] / q[2], lens[i, 1] / q[2]
        z = -(q[0] * x + q[1] * y) / q[2]
        g0 = x * T[0, 0] + y * T[1, 0] + z * T[2, 0]
        g1 = x * T[0, 1] + y * T[1, 1] + z * T[2, 1]
        g2 = x * T[0, 2] + y * T[1, 2] + z * T[2, 2]
        for k in range(3):
            by_point = g0 * R[0, k] + g1 * R[1, k] + g2 * R[2, k]
            rows[i, k], rows[i, 6 + k] = by_point, -by_point
        rows[i, 3] = g1 * p_imu[2] - g2 * p_imu[1]
        rows[i, 4] = g2 * p_imu[0] - g0 * p_imu[2]
        rows[i, 5] = g0 * p_imu[1] - g1 * p_imu[0]


@inlined_part
def _is_beside(lens: int, camera: FloatArray, x: float, y: float) -> bool:
    """Is a point of the ideal image plane in the image, or close beside it?"""
    u, v = to_pixel(lens, camera, x, y)
    beside = IMAGE_MARGIN * camera[10]
    in_width = -beside <= u <= camera[10] - 1.0 + beside
    return bool(in_width and -beside <= v <= camera[11] - 1.0 + beside)


@reordered_part
def inverse_motions(T: FloatArray) -> FloatArray:
    """Inverses (K, 4, 4) of rigid motions (K, 4, 4)."""
    out = np.zeros_like(T)
    for k in range(len(T)):
        for a in range(3):
            for b in range(3):
                out[k, a, b] = T[k, b, a]
                out[k, a, 3] += T[k, b, a] * T[k, b, 3]
            out[k, a, 3] = -out[k, a, 3]
        out[k, 3, 3] = 1.0
    return out


@part
def feature_rows(
    p_now: FloatArray,
    p_first: FloatArray,
    pixels: FloatArray,
    by_calibration: FloatArray,
    T_now: FloatArray,
    T_first: FloatArray,
    T_cam_imu: FloatArray,
    lens: IntArray,
    cameras: FloatArray,
    sigma: float,
    rows: FloatArray,
    clone: IntArray,
) -> int:
    """Whitened rows [point | clone | residual | calibration] (m, 10 + C) and their clones; m.

    Of one feature at world points `p_now` and `p_first` (3,), by latest and first estimates, seen
    as `pixels` (K, 4) from the poses `T_now` and `T_first` (K, 4, 4): T_imu_world of each clone;
    `by_calibration` (K, 4, C): ∂pixel/∂(calibration); `lens` (2,), `cameras` (2, 12): see
    `packed_cameras`. What a view must be to count: see `msckf_features.reproject`.
    """
    m, p_imu, at_first, q, J = 0, np.empty(3), np.empty(3), np.empty(3), np.empty((2, 2))
    for k in range(len(pixels)):
        transform(T_now[k], p_now, p_imu)
        transform(T_first[k], p_first, at_first)
        for c in range(2):
            camera = cameras[c]
            transform(T_cam_imu[c], p_imu, q)
            if not (math.isfinite(pixels[k, 2 * c]) and q[2] > 0.0):
                continue
            u, v = to_pixel(lens[c], camera, q[0] / q[2], q[1] / q[2])
            r0, r1 = pixels[k, 2 * c] - u, pixels[k, 2 * c + 1] - v
            transform(T_cam_imu[c], at_first, q)
            if not q[2] > 0.0:
                continue
            seen = _is_beside(lens[c], camera, q[0] / q[2], q[1] / q[2])
            if not (seen and math.isfinite(r0) and math.isfinite(r1)):
                continue
            J[0, 0], J[0, 1], J[1, 0], J[1, 1] = pixel_jacobian(
                lens[c], camera, q[0] / q[2], q[1] / q[2]
            )
            _view_rows(J, q, at_first, T_cam_imu[c], T_first[k], rows[m : m + 2])
            rows[m, 9], rows[m + 1, 9] = r0, r1
            for i in range(2):
                clone[m + i] = k
                for j in range(by_calibration.shape[2]):
                    rows[m + i, 10 + j] = by_calibration[k, 2 * c + i, j]
                for j in range(rows.shape[1]):
                    rows[m + i, j] /= sigma
            m += 2
    return m
