"""The compiled consistency of SLAM features: gate of each, weights, and the velocity of all.

tests/vio/plain_msckf.py holds the plain NumPy twin.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, reordered_part
from ovmot.vio.update_kernel import asked_velocity_distance, factor_with_rows, nearest_first

_LEAST = 3  # features: fewer than components of the velocity cannot contradict each other


@reordered_part
def _distances(P: FloatArray, H: FloatArray, residual: FloatArray, first: int) -> FloatArray:
    """Squared Mahalanobis distance (L,) of each landmark's innovation: rᵀ (H P Hᵀ + I)⁻¹ r."""
    n_landmarks, m, n = H.shape
    HP = np.empty((n_landmarks * m, len(P)))
    np.dot(H.reshape((n_landmarks * m, n)), P[first : first + n], HP)
    out, S = np.zeros(n_landmarks), np.empty((m + 1, m))
    for f in range(n_landmarks):
        for i in range(m):
            for j in range(i + 1):
                total = 1.0 if i == j else 0.0
                for k in range(n):
                    total += HP[f * m + i, first + k] * H[f, j, k]
                S[i, j] = total
            S[m, i] = residual[f, i]
        factor_with_rows(S, m, 1)
        for i in range(m):
            out[f] += S[m, i] * S[m, i]
    return out


def consistent_landmarks(
    P: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    first: int,
    dof: IntArray,
    bounds: FloatArray,
    velocity_bound: float,
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Landmarks that passed their gate (L,), and the weighted rows H (m, k), residual (m,) of those
    that are consistent; none where too few are.

    `H` (L, M, k) and `residual` (L, M): whitened, rows of zeros where nothing was seen, over the
    coordinates of `P` (N, N) from `first` on; `dof` (L,), `bounds` (L,): degrees of freedom and
    gate of each squared distance. See `innovation_consistency`.
    """
    n_landmarks, m, n = H.shape
    passed, ratio = np.zeros(n_landmarks, dtype=np.bool_), np.full(n_landmarks, np.inf)
    distance, order = _distances(P, H, residual, first), np.empty(n_landmarks, dtype=np.int64)
    for f in range(n_landmarks):
        if dof[f] > 0 and distance[f] < bounds[f]:
            passed[f], ratio[f] = True, math.sqrt(distance[f] / dof[f])
    candidates = nearest_first(ratio, order)
    kept = candidates
    while kept >= max(min(_LEAST, candidates), 1):
        rows, r = np.empty((kept * m, n)), np.empty(kept * m)
        for k in range(kept):
            f = order[k]
            weight = 1.0 / math.sqrt(max(ratio[f], 1.0))
            for i in range(m):
                r[k * m + i] = weight * residual[f, i]
                for j in range(n):
                    rows[k * m + i, j] = weight * H[f, i, j]
        if asked_velocity_distance(P, rows, r, first) < velocity_bound:
            return passed, rows, r
        kept //= 2
    return passed, np.empty((0, n)), np.empty(0)


_FOLDER = code_folder(Path(__file__))
consistent_landmarks_compiled = compiled(consistent_landmarks, _FOLDER, reorder=True)
