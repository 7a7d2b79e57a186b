"""The compiled measurement of SLAM features: rows of the newest view, gate, and consistency.

tests/fixtures/plain_msckf.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part, reordered_part
from ovmot.vio.reprojection_kernel import feature_rows, inverse_motions
from ovmot.vio.update_kernel import (
    factor_with_rows,
    give_weights,
    nearest_first,
    update_if_consistent,
)

_LEAST = 3  # features: fewer than components of the velocity cannot contradict each other
_POSE = 6  # coordinates of a clone


@part
def _project_out(A: FloatArray, m: int, b: int) -> None:
    """Clear A's first b columns below the diagonal by Householder reflections of its m rows."""
    v = np.empty(m)
    for j in range(b):
        square = 0.0
        for i in range(j, m):
            v[i] = A[i, j]
            square += v[i] * v[i]
        v[j] += math.copysign(math.sqrt(square), v[j])
        square += v[j] * v[j] - A[j, j] * A[j, j]
        for c in range(j, A.shape[1]):
            along = 0.0
            for i in range(j, m):
                along += v[i] * A[i, c]
            for i in range(j, m):
                A[i, c] -= 2.0 * along * v[i] / square if square > 0.0 else 0.0


def landmark_rows(
    p_now: FloatArray,
    p_first: FloatArray,
    by_value: FloatArray,
    by_anchor: FloatArray,
    anchor: IntArray,
    pixels: FloatArray,
    by_calibration: FloatArray,
    T_now: FloatArray,
    T_first: FloatArray,
    T_cam_imu: FloatArray,
    lens: IntArray,
    cameras: FloatArray,
    sigma: float,
    n_clones: int,
    size: int,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """H (L, 1 + s, k), residual (L, 1 + s) and degrees of freedom (L,) of the newest clone's view.

    `p_now`, `p_first`, `by_value`, `by_anchor`, `anchor`: see `LandmarkPoints`; `by_value` and
    `by_anchor` by the first estimates. `pixels` (L, 1, 4), `by_calibration` (L, 1, 4, C); `T_now`,
    `T_first` (1, 4, 4): T_world_imu of the newest clone; `size` s: coordinates of a landmark, the
    others are projected out. H is over the calibration, the clones and the landmarks.
    """
    n_landmarks, n_calibration = len(pixels), by_calibration.shape[3]
    n_bearing, first_landmark = 3 - size, n_calibration + _POSE * n_clones
    k = first_landmark + size * n_landmarks
    H, residual = np.zeros((n_landmarks, 1 + size, k)), np.zeros((n_landmarks, 1 + size))
    T_imu_now, T_imu_first = inverse_motions(T_now), inverse_motions(T_first)
    dof, clone = np.zeros(n_landmarks, np.int64), np.empty(4, np.int64)
    rows, A = np.empty((4, 10 + n_calibration)), np.empty((4, n_bearing + k + 1))
    for f in range(n_landmarks):
        m = feature_rows(
            p_now[f], p_first[f], pixels[f], by_calibration[f], T_imu_now, T_imu_first, T_cam_imu,
            lens, cameras, sigma, rows, clone,
        )  # fmt: skip
        A[:] = 0.0
        for i in range(m):
            for j in range(n_calibration):
                A[i, n_bearing + j] = rows[i, 10 + j]
            for j in range(_POSE):
                A[i, n_bearing + first_landmark - _POSE + j] = rows[i, 3 + j]
            A[i, -1] = rows[i, 9]
            for a in range(3):
                for j in range(3):
                    at = j if j < n_bearing else k + j - size * (n_landmarks - f)
                    A[i, at] += rows[i, a] * by_value[f, a, j]
                at = n_bearing + n_calibration + _POSE * anchor[f]
                for j in range(_POSE if anchor[f] >= 0 else 0):
                    A[i, at + j] += rows[i, a] * by_anchor[f, a, j]
        _project_out(A, m, n_bearing)
        dof[f] = max(m - n_bearing, 0)
        for i in range(dof[f]):
            residual[f, i] = A[n_bearing + i, -1]
            for j in range(k):
                H[f, i, j] = A[n_bearing + i, n_bearing + j]
    return H, residual, dof


@reordered_part
def _sparse_innovation(
    P: FloatArray, H: FloatArray, first: int, HP: FloatArray, S: FloatArray
) -> None:
    """`update_kernel.innovation` for H (m, k) of few elements a row; HP (m, N) is zero before."""
    m, n = H.shape
    column, count = np.empty((m, n), np.int64), np.zeros(m, np.int64)
    for i in range(m):
        for k in range(n):
            if H[i, k] != 0.0:
                column[i, count[i]] = k
                count[i] += 1
                for j in range(len(P)):
                    HP[i, j] += H[i, k] * P[first + k, j]
        for j in range(i + 1):
            total = 1.0 if i == j else 0.0
            for c in range(count[j]):
                total += HP[i, first + column[j, c]] * H[j, column[j, c]]
            S[i, j] = S[j, i] = total


@reordered_part
def _distances(S: FloatArray, residual: FloatArray) -> FloatArray:
    """Squared Mahalanobis distance (L,) of each landmark's innovation: rᵀ (H P Hᵀ + I)⁻¹ r.

    `S` holds the innovation covariance of all rows together, `residual` (L, m).
    """
    n_landmarks, m = residual.shape
    out, own = np.zeros(n_landmarks), np.empty((m + 1, m))
    for f in range(n_landmarks):
        for i in range(m):
            for j in range(m):
                own[i, j] = S[f * m + i, f * m + j]
            own[m, i] = residual[f, i]
        factor_with_rows(own)
        for i in range(m):
            out[f] += own[m, i] * own[m, i]
    return out


def update_by_landmarks(
    P: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    first: int,
    considered: tuple[int, int],
    dof: IntArray,
    bounds: FloatArray,
    velocity_bound: float,
) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """One update by the landmarks that are consistent: passed, weight, error, covariance.

    `H` (L, m, k) and `residual` (L, m): whitened, rows of zeros where nothing was seen, over the
    coordinates of `P` (N, N) from `first` on; `considered`: see `update_if_consistent`; `dof` (L,),
    `bounds` (L,): degrees of freedom and gate of each squared distance. `passed` (L,): those that
    passed their own gate; `weight` (L,): see `innovation_consistency`, all 0 where too few are
    consistent; the error vector (N,) and the covariance (N, N) after the update.
    """
    n_landmarks, m, n = H.shape
    HP, S = np.zeros((n_landmarks * m, len(P))), np.empty((n_landmarks * m, n_landmarks * m))
    _sparse_innovation(P, H.reshape((n_landmarks * m, n)), first, HP, S)
    passed, ratio = np.zeros(n_landmarks, dtype=np.bool_), np.full(n_landmarks, np.inf)
    distance, order = _distances(S, residual), np.empty(n_landmarks, dtype=np.int64)
    for f in range(n_landmarks):
        if dof[f] > 0 and distance[f] < bounds[f]:
            passed[f], ratio[f] = True, math.sqrt(distance[f] / dof[f])
    weight, error, updated = np.zeros(n_landmarks), np.zeros(len(P)), np.empty(P.shape)
    candidates = nearest_first(ratio, order)
    kept = candidates
    while kept >= max(min(_LEAST, candidates), 1):
        give_weights(ratio, order, kept, weight)
        rows, T, r = _weighted(HP, S, residual, weight, dof)
        if update_if_consistent(P, rows, T, r, considered, velocity_bound, error, updated):
            return passed, weight, error, updated
        kept //= 2
    weight[:] = 0.0
    return passed, weight, error, P


@reordered_part
def _weighted(
    HP: FloatArray, S: FloatArray, residual: FloatArray, weight: FloatArray, dof: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """H P, innovation covariance and residual of the rows that have a weight, scaled.

    Of a landmark the first `dof` rows are those that are not zero.
    """
    n_landmarks, m = residual.shape
    scale, row = np.empty(n_landmarks * m), np.empty(n_landmarks * m, dtype=np.int64)
    count = 0
    for f in range(n_landmarks):
        if weight[f] > 0.0:
            for i in range(dof[f]):
                scale[count], row[count] = weight[f], f * m + i
                count += 1
    rows, T = np.empty((count, HP.shape[1])), np.empty((count + _LEAST + 1, count))
    r = np.empty(count)
    for i in range(count):
        r[i] = scale[i] * residual[row[i] // m, row[i] % m]
        for j in range(HP.shape[1]):
            rows[i, j] = scale[i] * HP[row[i], j]
        for j in range(i):
            T[i, j] = scale[i] * scale[j] * S[row[i], row[j]]
        T[i, i] = scale[i] * scale[i] * (S[row[i], row[i]] - 1.0) + 1.0
    return rows, T, r


_FOLDER = code_folder(Path(__file__))
landmark_rows_compiled = compiled(landmark_rows, _FOLDER)
update_by_landmarks_compiled = compiled(update_by_landmarks, _FOLDER, reorder=True)
