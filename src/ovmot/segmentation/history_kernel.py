"""The compiled comparison of stereo points then and now, point by point.

tests/segmentation/test_history_kernel.py holds its plain NumPy twin.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import add_products, invert_symmetric, whiten, whiten_with
from ovmot.kernels.stereo import project, secant, stereo_covariance, transform, triangulate

_LEAST_DEPTH = 0.1  # metres, of a predicted point


def triangulate_pairs(
    pairs: FloatArray, T_cam1_cam0: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (M, 3) of normalized stereo pairs (M, 4), and covariances (M, 3, 3); NaN for none.

    `sigma` (4,): standard deviations of the normalized coordinates.
    """
    n = len(pairs)
    p, C = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    found = np.empty(3)
    for k in range(n):
        if triangulate(pairs[k], T_cam1_cam0, found):
            for a in range(3):
                p[k, a] = found[a]
            stereo_covariance(found, T_cam1_cam0, sigma, C[k])
    return p, C


def compare_points(
    p_then: FloatArray,
    cov_then: FloatArray,
    then: FloatArray,
    p_now: FloatArray,
    now: FloatArray,
    T_now_then: FloatArray,
    ego: FloatArray,
    T_cam1_cam0: FloatArray,
    sigma: FloatArray,
    drift: FloatArray,
    drift_per_flow: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """What `StaticComparison` holds: predicted, residual, J, J_motion, S, S_motion.

    The first five are those of a `StereoHistory`; `T_now_then` (L, 4, 4) of the left camera. `ego`
    (L, 6, 6): covariance of (φ, τ), by which the ego motion's error moves a predicted point p as
    [p]x φ + τ. `sigma` (4,), `drift` (L,): standard deviations in normalized units of the pixels
    and of a tracked patch; `drift_per_flow` of the way in the left image. With
    C = R C_then Rᵀ + ego's part, S = J C Jᵀ + noise, at the predicted and at the present place.
    """
    n_rows, n_points = then.shape[:2]
    predicted, residual = np.full((n_rows, n_points, 3), np.nan), np.full(then.shape, np.nan)
    J, J_motion = (
        np.full((n_rows, n_points, 4, 3), np.nan),
        np.full((n_rows, n_points, 4, 3), np.nan),
    )
    S, S_motion = (
        np.full((n_rows, n_points, 4, 4), np.nan),
        np.full((n_rows, n_points, 4, 4), np.nan),
    )
    h, C, J_now = np.empty(4), np.empty((3, 3)), np.empty((4, 3))
    for n in range(n_points):
        if not math.isfinite(p_now[n, 2]):
            continue
        project(p_now[n], T_cam1_cam0, h, J_now)
        for row in range(n_rows):
            if not math.isfinite(p_then[row, n, 2]):
                continue
            T, p = T_now_then[row], predicted[row, n]
            transform(T, p_then[row, n], p)
            if not p[2] > _LEAST_DEPTH:
                p[0] = p[1] = p[2] = np.nan
                continue
            predicted_covariance(T, cov_then[row, n], p, ego[row], C)
            project(p, T_cam1_cam0, h, J[row, n])
            flow = math.hypot(now[n, 0] - then[row, n, 0], now[n, 1] - then[row, n, 1])
            drifted = drift[row] ** 2 + (drift_per_flow * flow) ** 2
            image_covariance(J[row, n], C, sigma, drifted, S[row, n])
            image_covariance(J_now, C, sigma, drifted, S_motion[row, n])
            for i in range(4):
                residual[row, n, i] = now[n, i] - h[i]
            secant(p, p_now[n], T_cam1_cam0, J_motion[row, n])
    return predicted, residual, J, J_motion, S, S_motion


def fit_velocities(
    residual: FloatArray,
    J_motion: FloatArray,
    S: FloatArray,
    J_slack: FloatArray,
    slack: FloatArray,
    span_s: FloatArray,
    tested: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Velocity (N, 3), covariance (N, 3, 3) and cost (N,) of r = J_motion v Δt over L rows.

    Weighted least squares; r (L, N, 4) has the covariance S + `slack` (L,) J_slack J_slackᵀ.
    """
    n_rows, n_points = residual.shape[:2]
    velocity, cost = np.empty((n_points, 3)), np.empty(n_points)
    covariance = np.empty((n_points, 3, 3))
    L, rows = np.empty((4, 4)), np.empty((4, 4))
    products, information = np.empty((4, 4)), np.empty((3, 3))
    for n in range(n_points):
        products[:, :] = 0.0
        for row in range(n_rows):
            if tested[row, n]:
                widen(S[row, n], J_slack[row, n], slack[row], L)
                for i in range(4):
                    rows[i, 3] = residual[row, n, i]
                    for k in range(3):
                        rows[i, k] = J_motion[row, n, i, k] * span_s[row]
                whiten(L, rows)
                add_products(rows, products)
        for a in range(3):
            for b in range(3):
                information[a, b] = products[a, b] + (1e-6 if a == b else 0.0)
        invert_symmetric(information, covariance[n])
        cost[n] = products[3, 3]
        for a in range(3):
            velocity[n, a] = 0.0
            for b in range(3):
                velocity[n, a] += covariance[n, a, b] * products[b, 3]
        for a in range(3):
            cost[n] -= 2.0 * velocity[n, a] * products[a, 3]
            for b in range(3):
                cost[n] += velocity[n, a] * products[a, b] * velocity[n, b]
    return velocity, covariance, cost


def weigh(
    J_motion: FloatArray, S_motion: FloatArray, tested: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """S_motion⁻¹ (L, N, 4, 4), and information J_motionᵀ S_motion⁻¹ J_motion (L, N, 3, 3).

    Zero where untested.
    """
    n_rows, n_points = tested.shape
    weight, information = np.zeros(S_motion.shape), np.zeros((n_rows, n_points, 3, 3))
    L, root, J = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 3))
    for row in range(n_rows):
        for n in range(n_points):
            if tested[row, n]:
                for i in range(4):
                    for j in range(4):
                        L[i, j], root[i, j] = S_motion[row, n, i, j], 1.0 if i == j else 0.0
                    for j in range(3):
                        J[i, j] = J_motion[row, n, i, j]
                whiten(L, root)
                whiten_with(L, J)
                add_products(root, weight[row, n])
                add_products(J, information[row, n])
    return weight, information


def distance_from_static(
    p_then: FloatArray, p_now: FloatArray, cov_now: FloatArray, T_now_then: FloatArray
) -> FloatArray:
    """Roughly, the squared Mahalanobis distance (N,) of points from where static ones would be.

    Since the oldest time of a point's history: `p_then` (L, N, 3), oldest first; `p_now` (N, 3)
    with covariance (N, 3, 3). Axes apart and with the present covariance for both times: quick, to
    spare most points the full comparison.
    """
    n_rows, n_points = p_then.shape[:2]
    distance = np.zeros(n_points)
    q = np.empty(3)
    for n in range(n_points):
        if not math.isfinite(p_now[n, 2]):
            continue
        for row in range(n_rows):
            if math.isfinite(p_then[row, n, 2]):
                transform(T_now_then[row], p_then[row, n], q)
                for a in range(3):
                    distance[n] += (q[a] - p_now[n, a]) ** 2 / (2.0 * cov_now[n, a, a])
                break
    return distance


@part
def predicted_covariance(
    T: FloatArray, C_then: FloatArray, p: FloatArray, ego: FloatArray, C: FloatArray
) -> None:
    """C (3, 3) = R C_then Rᵀ + B ego Bᵀ, B = ([p]x, I)."""
    B, BE, RC = np.zeros((3, 6)), np.empty((3, 6)), np.empty((3, 3))
    B[0, 1], B[0, 2], B[1, 0] = -p[2], p[1], p[2]
    B[1, 2], B[2, 0], B[2, 1] = -p[0], -p[1], p[0]
    B[0, 3] = B[1, 4] = B[2, 5] = 1.0
    for a in range(3):
        for k in range(3):
            RC[a, k] = T[a, 0] * C_then[0, k] + T[a, 1] * C_then[1, k] + T[a, 2] * C_then[2, k]
        for k in range(6):
            BE[a, k] = ego[3 + a, k]
            for m in range(3):
                BE[a, k] += B[a, m] * ego[m, k]
    for a in range(3):
        for b in range(a, 3):
            C[a, b] = RC[a, 0] * T[b, 0] + RC[a, 1] * T[b, 1] + RC[a, 2] * T[b, 2] + BE[a, 3 + b]
            for m in range(3):
                C[a, b] += BE[a, m] * B[b, m]
            C[b, a] = C[a, b]


@part
def image_covariance(
    J: FloatArray, C: FloatArray, sigma: FloatArray, drifted: float, S: FloatArray
) -> None:
    """S (4, 4) = J C Jᵀ + diag(sigma²) + drifted I."""
    for i in range(4):
        x = J[i, 0] * C[0, 0] + J[i, 1] * C[1, 0] + J[i, 2] * C[2, 0]
        y = J[i, 0] * C[0, 1] + J[i, 1] * C[1, 1] + J[i, 2] * C[2, 1]
        z = J[i, 0] * C[0, 2] + J[i, 1] * C[1, 2] + J[i, 2] * C[2, 2]
        for j in range(4):
            S[i, j] = x * J[j, 0] + y * J[j, 1] + z * J[j, 2]
        S[i, i] += sigma[i] ** 2 + drifted


@part
def widen(S: FloatArray, J: FloatArray, slack: float, out: FloatArray) -> None:
    """S + slack J Jᵀ (4, 4) of J (4, 3)."""
    for i in range(4):
        for j in range(4):
            out[i, j] = S[i, j]
            for k in range(3):
                out[i, j] += slack * J[i, k] * J[j, k]


_FOLDER = code_folder(Path(__file__))
triangulate_pairs_compiled = compiled(triangulate_pairs, _FOLDER)
compare_points_compiled = compiled(compare_points, _FOLDER)
fit_velocities_compiled = compiled(fit_velocities, _FOLDER)
weigh_compiled = compiled(weigh, _FOLDER)
distance_from_static_compiled = compiled(distance_from_static, _FOLDER)
