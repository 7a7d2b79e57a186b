"""The compiled MSCKF measurement: rows of each feature, gate, and one set of compressed rows.

A row of the reprojection error depends on one clone, on the point and on the calibration. So a
feature's nullspace projection is never carried out: with Q (m, 3) orthonormal, its columns those of
the Jacobian by the point, and E = Qᵀ H, the projected rows have the information HᵀH - EᵀE, where
HᵀH has one block a clone; and the projected innovation's distance is that of r less what Q's
columns explain. Both are the same as by the rows in the left nullspace (A. Mourikis &
S. Roumeliotis, ICRA 2007), at a fraction of the cost.

tests/fixtures/plain_msckf.py holds the plain NumPy twin, which does project.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part, reordered_part
from ovmot.vio.reprojection_kernel import feature_rows, inverse_motions
from ovmot.vio.update_kernel import (
    explained_square,
    factor_with_rows,
    give_weights,
    innovation,
    nearest_first,
    orthonormalize_rows,
    transposed,
    update_if_consistent,
)

_POINT, _POSE, _VIEW = 3, 6, 4  # coordinates of a point and a clone; of a stereo view


@part
def _point_basis(rows: FloatArray, Q: FloatArray, R: FloatArray) -> None:
    """Q (3, m), its rows orthonormal, and triangular R (3, 3) with Qᵀ R the point's Jacobian."""
    m = Q.shape[1]
    for a in range(_POINT):
        for i in range(m):
            Q[a, i] = rows[i, a]
    orthonormalize_rows(Q)
    for a in range(_POINT):
        for j in range(a, _POINT):
            R[a, j] = 0.0
            for i in range(m):
                R[a, j] += Q[a, i] * rows[i, j]


@reordered_part
def _times_covariance(
    rows: FloatArray, clone: IntArray, m: int, P: FloatArray, out: FloatArray
) -> None:
    """out (m, n) = H P, with P (n, n) that of the calibration and the clones."""
    n_calibration = rows.shape[1] - 10
    for i in range(m):
        at = n_calibration + _POSE * clone[i]
        for j in range(len(P)):
            out[i, j] = 0.0
        for k in range(_POSE):
            h = rows[i, 3 + k]
            for j in range(len(P)):
                out[i, j] += h * P[at + k, j]
        for k in range(n_calibration):
            h = rows[i, 10 + k]
            if h != 0.0:  # a view depends on its own camera's only
                for j in range(len(P)):
                    out[i, j] += h * P[k, j]


@reordered_part
def _projected_distance(
    rows: FloatArray, clone: IntArray, m: int, Q: FloatArray, P: FloatArray
) -> float:
    """Squared Mahalanobis distance of the innovation in the left nullspace of the point's Jacobian.

    With S = H P Hᵀ + I = L Lᵀ, y = L⁻¹ r and Z = L⁻¹ Qᵀ: yᵀy less its part in Z's columns.
    """
    n_calibration = rows.shape[1] - 10
    HP, S = np.empty((m, len(P))), np.empty((m + _POINT + 1, m))
    _times_covariance(rows, clone, m, P, HP)
    for i in range(m):
        for j in range(i + 1):
            at = n_calibration + _POSE * clone[j]
            total = 1.0 if i == j else 0.0
            for k in range(_POSE):
                total += HP[i, at + k] * rows[j, 3 + k]
            for k in range(n_calibration):
                total += HP[i, k] * rows[j, 10 + k]
            S[i, j] = total
        for a in range(_POINT):
            S[m + a, i] = Q[a, i]
        S[m + _POINT, i] = rows[i, 9]
    factor_with_rows(S)
    square = 0.0
    for i in range(m):
        square += S[m + _POINT, i] * S[m + _POINT, i]
    return square - explained_square(S[m:])


@reordered_part
def _rows_in_basis(rows: FloatArray, clone: IntArray, m: int, Q: FloatArray, E: FloatArray) -> None:
    """E (3, n + 1) = Q [H | r]: the rows that determine the point."""
    n_calibration = rows.shape[1] - 10
    for a in range(_POINT):
        for j in range(E.shape[1]):
            E[a, j] = 0.0
        for i in range(m):
            at = n_calibration + _POSE * clone[i]
            for k in range(_POSE):
                E[a, at + k] += Q[a, i] * rows[i, 3 + k]
            for k in range(n_calibration):
                E[a, k] += Q[a, i] * rows[i, 10 + k]
            E[a, -1] += Q[a, i] * rows[i, 9]


@reordered_part
def _add_information(
    rows: FloatArray, clone: IntArray, m: int, weight: float, G: FloatArray
) -> None:
    """Add weight² [H | r]ᵀ [H | r] to the lower triangle of G (n + 1, n + 1)."""
    n, n_calibration, square = len(G) - 1, rows.shape[1] - 10, weight * weight
    for i in range(m):
        at, r = n_calibration + _POSE * clone[i], rows[i, 9]
        for a in range(_POSE):
            scaled = square * rows[i, 3 + a]
            for b in range(a + 1):
                G[at + a, at + b] += scaled * rows[i, 3 + b]
            for b in range(n_calibration):
                G[at + a, b] += scaled * rows[i, 10 + b]
            G[n, at + a] += scaled * r
        for a in range(n_calibration):
            scaled = square * rows[i, 10 + a]
            for b in range(a + 1):
                G[a, b] += scaled * rows[i, 10 + b]
            G[n, a] += scaled * r


@reordered_part
def compressed(G: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H (k, n), of rank k, and residual (k,) with G = [H | r]ᵀ [H | r], but for rᵀr.

    A Cholesky factor with diagonal pivoting of G's lower triangle (n + 1, n + 1), scaled to a
    diagonal of ones; it ends where what is left is rounding (N. Higham, "Accuracy and Stability of
    Numerical Algorithms", sec. 10.3).
    """
    n = len(G) - 1
    scale, left, L = np.ones(n + 1), np.zeros(n), np.zeros((n + 1, n))
    for i in range(n):
        if G[i, i] > 0.0:
            scale[i], left[i] = math.sqrt(G[i, i]), 1.0
    rank = 0
    while rank < n:
        p = 0
        for i in range(1, n):
            if left[i] > left[p]:
                p = i
        if not left[p] > 1e-13:  # of a diagonal of ones: what is less is rounding
            break
        pivot = math.sqrt(left[p])
        for i in range(n + 1):
            if i < n and left[i] <= 0.0:
                continue
            total = G[max(i, p), min(i, p)] / (scale[i] * scale[p])
            for k in range(rank):
                total -= L[i, k] * L[p, k]
            L[i, rank] = total / pivot
            if i < n:
                left[i] -= L[i, rank] * L[i, rank]
        L[p, rank], left[p] = pivot, 0.0
        rank += 1
    H, residual = np.empty((rank, n)), np.empty(rank)
    for k in range(rank):
        residual[k] = L[n, k]
        for i in range(n):
            H[k, i] = L[i, k] * scale[i]
    return H, residual


@reordered_part
def _measure(
    rows: FloatArray, clone: IntArray, m: int, P: FloatArray, enough: float, R: FloatArray,
    E: FloatArray,
) -> float:  # fmt: skip
    """A feature's distance by its m > 3 rows; R (3, 3) and E (3, n + 1), the point's rows.

    The innovation's covariance is the noise I and more, so the squared length of the projected
    innovation is a bound of the distance. A bound up to `enough` is given in place of it.
    """
    Q = np.empty((_POINT, m))
    _point_basis(rows, Q, R)
    _rows_in_basis(rows, clone, m, Q, E)
    bound = 0.0
    for i in range(m):
        bound += rows[i, 9] * rows[i, 9]
    for a in range(_POINT):
        bound -= E[a, -1] * E[a, -1]
    return bound if bound <= enough else _projected_distance(rows, clone, m, Q, P)


@reordered_part
def _weighted_information(
    rows: FloatArray, clone: IntArray, count: IntArray, E: FloatArray, weight: FloatArray
) -> FloatArray:
    """[H | r]ᵀ [H | r], the lower triangle (n + 1, n + 1), of the projected rows by weight (F,)."""
    n = E.shape[2]
    G, explained, X = np.zeros((n, n)), np.empty((n, n)), np.zeros((_POINT * len(E), n))
    for f in range(len(E)):
        if weight[f] > 0.0:
            _add_information(rows[f], clone[f], count[f], weight[f], G)
            for a in range(_POINT):
                for j in range(n):
                    X[_POINT * f + a, j] = weight[f] * E[f, a, j]
    np.dot(transposed(X, len(X)), X, explained)
    for i in range(n):
        for j in range(i + 1):
            G[i, j] -= explained[i, j]
    return G


def update_by_features(
    points: FloatArray,
    pixels: FloatArray,
    by_calibration: FloatArray,
    T_now: FloatArray,
    T_first: FloatArray,
    T_cam_imu: FloatArray,
    lens: IntArray,
    cameras: FloatArray,
    sigma: float,
    P: FloatArray,
    first: int,
    n_considered: int,
    bounds: FloatArray,
    velocity_bound: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """One update by all features that are consistent: weight, error, covariance, R, E.

    `points` (F, 3) in world; `pixels` (F, K, 4), NaN where not to be used; `by_calibration`
    (F, K, 4, C): ∂pixel/∂(calibration); `T_now`, `T_first` (K, 4, 4): T_world_imu of the clones, by
    latest and first estimates; `T_cam_imu` (2, 4, 4); `lens`, `cameras`: see `packed_cameras`; `P`
    (N, N), of which the calibration begins at `first` and the clones follow; `n_considered`: of the
    calibration, the last coordinates, which no update changes; `bounds` (4K + 1,):
    gate of a feature's distance by its degrees of freedom.

    `weight` (F,): see `innovation_consistency`, all 0 where too few are consistent; the error
    vector (N,) and the covariance (N, N) after the update; `R` (F, 3, 3), `E` (F, 3, n + 1):
    R δp + E (x, -1) = noise of variance 1, the rows that determine each point.
    """
    n_features, n_clones = pixels.shape[:2]
    n = by_calibration.shape[3] + _POSE * n_clones
    rows = np.empty((n_features, _VIEW * n_clones, 10 + by_calibration.shape[3]))
    clone = np.empty((n_features, _VIEW * n_clones), dtype=np.int64)
    count, order = np.zeros(n_features, np.int64), np.empty(n_features, dtype=np.int64)
    R, E = np.zeros((n_features, _POINT, _POINT)), np.zeros((n_features, _POINT, n + 1))
    T_imu_now, T_imu_first = inverse_motions(T_now), inverse_motions(T_first)
    window, ratio = np.empty((n, n)), np.full(n_features, np.inf)
    for i in range(n):
        for j in range(n):
            window[i, j] = P[first + i, first + j]
    for f in range(n_features):
        m = feature_rows(
            points[f], points[f], pixels[f], by_calibration[f], T_imu_now, T_imu_first, T_cam_imu,
            lens, cameras, sigma, rows[f], clone[f],
        )  # fmt: skip
        count[f], dof = m, m - _POINT
        if dof > 0:  # up to the degrees of freedom all have weight 1
            enough = min(float(dof), bounds[dof])
            distance = _measure(rows[f], clone[f], m, window, enough, R[f], E[f])
            if distance < bounds[dof]:
                ratio[f] = math.sqrt(distance / dof)
    candidates = nearest_first(ratio, order)
    weight, error, updated = np.zeros(n_features), np.zeros(len(P)), np.empty(P.shape)
    kept, clones_at = candidates, first + by_calibration.shape[3]
    considered = clones_at - n_considered, clones_at
    while kept >= max(min(_POINT, candidates), 1):
        give_weights(ratio, order, kept, weight)
        H, residual = compressed(_weighted_information(rows, clone, count, E, weight))
        HP, S = np.empty((len(H), len(P))), np.empty((len(H) + _POINT + 1, len(H)))
        innovation(P, H, first, HP, S)
        if update_if_consistent(P, HP, S, residual, considered, velocity_bound, error, updated):
            return weight, error, updated, R, E
        if kept == candidates:  # which are the nearest half? Bounds do not tell
            for k in range(candidates):
                f, m = order[k], count[order[k]]
                distance = _measure(rows[f], clone[f], m, window, -1.0, R[f], E[f])
                ratio[f] = math.sqrt(distance / (m - _POINT))
            nearest_first(ratio, order)
        kept //= 2
    weight[:] = 0.0
    return weight, error, P, R, E


_FOLDER = code_folder(Path(__file__))
update_by_features_compiled = compiled(update_by_features, _FOLDER, reorder=True)
