"""The compiled stereo history: triangulated pairs, and the ego motion since earlier frames.

tests/segmentation/test_history_kernel.py holds the plain NumPy twins.
"""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part
from ovmot.kernels.stereo import stereo_covariance, triangulate


def triangulate_pairs(
    then: FloatArray, now: FloatArray, T_cam1_cam0: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points `p_then` (L, N, 3), `p_now` (N, 3) of normalized pairs; NaN where there is none.

    Also the covariance (N, 3, 3) of those now. `sigma` (4,): standard deviations of the normalized
    coordinates.
    """
    n_rows, n_points = then.shape[:2]
    p_then, p_now = np.empty((n_rows, n_points, 3)), np.empty((n_points, 3))
    cov_now = np.empty((n_points, 3, 3))
    for n in range(n_points):
        if triangulate(now[n], T_cam1_cam0, p_now[n]):
            stereo_covariance(p_now[n], T_cam1_cam0, sigma, cov_now[n])
        else:
            p_now[n, :] = np.nan
            cov_now[n, :, :] = np.nan
        for row in range(n_rows):
            if not triangulate(then[row, n], T_cam1_cam0, p_then[row, n]):
                p_then[row, n, :] = np.nan
    return p_then, p_now, cov_now


def ego_motion(
    T_world_imu: FloatArray, P: FloatArray, clone: IntArray, T_imu_cam0: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`T_now_then` and `covariance` of an `EgoMotion`, since the clones (L,) of a window.

    `T_world_imu` (K, 4, 4) with joint covariance P (6K, 6K), newest last. In the camera's axes,
    with T = T_cam0_imu the camera's pose and R, t the motion of the IMU since then, p_now = R p + t
    moves by [p_now]x (δθ_n - R δθ_t) + [t]x R δθ_t + R_nᵀ (δt_t - δt_n), poses perturbed on the
    right.
    """
    n, last = len(clone), len(T_world_imu) - 1
    T_now_then, covariance = np.zeros((n, 4, 4)), np.zeros((n, 6, 6))
    T_cam_imu, T_cam_world, T_cam_then = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    A, AP = np.empty((6, 12)), np.empty((6, 12))
    inverse_motion(T_imu_cam0, T_cam_imu)
    inverse_motion(T_world_imu[last], T_cam_then)
    compose_motions(T_cam_imu, T_cam_then, T_cam_world)
    for row in range(n):
        compose_motions(T_cam_world, T_world_imu[clone[row]], T_cam_then)
        compose_motions(T_cam_then, T_imu_cam0, T_now_then[row])
        by_poses(T_cam_imu, T_cam_world, T_cam_then, A)
        for a in range(6):
            for b in range(12):
                AP[a, b] = 0.0
                column = 6 * last + b if b < 6 else 6 * (clone[row] - 1) + b
                for c in range(6):
                    AP[a, b] += A[a, c] * P[6 * last + c, column]
                    AP[a, b] += A[a, 6 + c] * P[6 * clone[row] + c, column]
        for a in range(6):
            for b in range(6):
                for c in range(12):
                    covariance[row, a, b] += AP[a, c] * A[b, c]
    return T_now_then, covariance


@inlined_part
def by_poses(
    T_cam_imu: FloatArray, T_cam_world: FloatArray, T_cam_then: FloatArray, A: FloatArray
) -> None:
    """Derivative A (6, 12) of (φ, τ) by the errors of the IMU's poses now and then.

    `T_cam_world` of the present camera, `T_cam_then` from the earlier IMU into it. A rotation δ
    about a centre c of the camera's axes moves p by [p]x (-R δ) + [c]x R δ.
    """
    for k in range(3):
        for side in range(2):
            T, sign = (T_cam_imu, 1.0) if side == 0 else (T_cam_then, -1.0)
            c, shift = 6 * side + k, 6 * side + 3 + k
            r0, r1, r2 = sign * T[0, k], sign * T[1, k], sign * T[2, k]
            A[0, c], A[1, c], A[2, c] = r0, r1, r2
            # -[c]x r with the centre c = T[:3, 3]
            A[3, c] = r1 * T[2, 3] - r2 * T[1, 3]
            A[4, c] = r2 * T[0, 3] - r0 * T[2, 3]
            A[5, c] = r0 * T[1, 3] - r1 * T[0, 3]
            for a in range(3):
                A[a, shift] = 0.0
                A[3 + a, shift] = -sign * T_cam_world[a, k]


@inlined_part
def inverse_motion(T: FloatArray, out: FloatArray) -> None:
    """Inverse (4, 4) of a rigid motion."""
    for a in range(3):
        for b in range(3):
            out[a, b] = T[b, a]
        out[a, 3] = -(T[0, a] * T[0, 3] + T[1, a] * T[1, 3] + T[2, a] * T[2, 3])
        out[3, a] = 0.0
    out[3, 3] = 1.0


@inlined_part
def compose_motions(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """out (4, 4) = A B of rigid motions."""
    for a in range(3):
        for b in range(4):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
        out[a, 3] += A[a, 3]
        out[3, a] = 0.0
    out[3, 3] = 1.0


_FOLDER = code_folder(Path(__file__))
triangulate_pairs_compiled = compiled(triangulate_pairs, _FOLDER)
ego_motion_compiled = compiled(ego_motion, _FOLDER)
