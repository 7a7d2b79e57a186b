"""The compiled algebra of an update: factors, the consistency of many rows, the Kalman update.

Called by kernels only. All matrices are contiguous (C order). The plain NumPy twins are in
`vio.update` and tests/fixtures/plain_msckf.py.
"""

import math

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import part, reordered_part

_VELOCITY, _VELOCITY_DOF = 6, 3  # where the velocity is in the error state


@reordered_part
def factor_with_rows(A: FloatArray, n: int, more: int) -> None:
    """Cholesky factor L of I + M, in place, and L⁻¹ of the rows below.

    The lower triangle of A's first n rows is I + M with M positive semidefinite; each of the `more`
    rows below is a vector b (n,), replaced by L⁻¹ b. No pivot of such a matrix is below 1: where
    rounding of large entries has lost the noise, it is put back.
    """
    for i in range(n + more):
        for j in range(min(i + 1, n)):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                A[i, i] = math.sqrt(total if total > 1.0 or math.isnan(total) else 1.0)
            else:
                A[i, j] = total / A[j, j]


@reordered_part
def inverse_factor(L: FloatArray, n: int, out: FloatArray) -> None:
    """out (n, n): inverse of the lower triangular L (n, n)."""
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(i):
            factor = L[i, k]
            for j in range(k + 1):
                out[i, j] -= factor * out[k, j]
        for j in range(i):
            out[i, j] /= L[i, i]
        out[i, i] = 1.0 / L[i, i]


@part
def nearest_first(size: FloatArray, order: IntArray) -> int:
    """The indices of finite sizes (F,) into `order` (F,), in rising order, stable; their number."""
    n = 0
    for f in range(len(size)):
        if math.isfinite(size[f]):
            k = n
            while k > 0 and size[order[k - 1]] > size[f]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = f
            n += 1
    return n


@reordered_part
def velocity_distance(rows: FloatArray, n: int) -> float:
    """Squared Mahalanobis distance (3 dof) of the velocity that an update asks for.

    `rows` (4, n): Wᵀ for the velocity, by W = L⁻¹ H P_v, and the whitened innovation y; changed in
    place. The squared length of y's projection on W's columns (Gram-Schmidt, twice).
    """
    total = 0.0
    for a in range(_VELOCITY_DOF):
        before = 0.0
        for k in range(n):
            before += rows[a, k] * rows[a, k]
        for _ in range(2):
            for b in range(a):
                along = 0.0
                for k in range(n):
                    along += rows[b, k] * rows[a, k]
                for k in range(n):
                    rows[a, k] -= along * rows[b, k]
        square = 0.0
        for k in range(n):
            square += rows[a, k] * rows[a, k]
        if square <= 1e-24 * before:  # no direction of its own
            square = math.inf
        along, scale = 0.0, 1.0 / math.sqrt(square)
        for k in range(n):
            rows[a, k] *= scale
            along += rows[a, k] * rows[_VELOCITY_DOF, k]
        total += along * along
    return total


@reordered_part
def transposed(A: FloatArray, n: int) -> FloatArray:
    """The transpose (k, n) of the first n rows of A (., k), contiguous."""
    out = np.empty((A.shape[1], n))
    for i in range(n):
        for j in range(A.shape[1]):
            out[j, i] = A[i, j]
    return out


@reordered_part
def innovation(P: FloatArray, H: FloatArray, first: int, HP: FloatArray, S: FloatArray) -> None:
    """HP (m, N) = H P, and S's first m rows = H P Hᵀ + I, for H (m, k) over P[first:first + k]."""
    m, n = H.shape
    block, out = np.empty((m, n)), np.empty((m, m))
    np.dot(H, P[first : first + n], HP)
    for i in range(m):
        for j in range(n):
            block[i, j] = HP[i, first + j]
    np.dot(block, transposed(H, m), out)
    for i in range(m):
        for j in range(m):
            S[i, j] = out[i, j]
        S[i, i] += 1.0


@reordered_part
def update_if_consistent(
    P: FloatArray,
    HP: FloatArray,
    S: FloatArray,
    residual: FloatArray,
    velocity_bound: float,
    error: FloatArray,
    updated: FloatArray,
) -> bool:
    """Update by m rows of noise 1, unless the velocity that they ask for is beyond the bound.

    `HP` (m, N), `S` (m + 4, m): see `innovation`; S is changed in place. The error vector (N,) and
    the new covariance (N, N) are filled in; False, and they are not, beyond `velocity_bound`. As
    `update.ekf_update`: S = L Lᵀ, W = L⁻¹ H P, the covariance becomes P - Wᵀ W.
    """
    m, n = HP.shape
    for i in range(m):
        for a in range(_VELOCITY_DOF):
            S[m + a, i] = HP[i, _VELOCITY + a]
        S[m + _VELOCITY_DOF, i] = residual[i]
    factor_with_rows(S, m, _VELOCITY_DOF + 1)
    y = S[m + _VELOCITY_DOF].copy()
    if not velocity_distance(S[m:], m) < velocity_bound:
        return False
    inverse, W = np.empty((m, m)), np.empty((m, n))
    inverse_factor(S, m, inverse)
    np.dot(inverse, HP, W)
    np.dot(transposed(W, m), W, updated)
    for j in range(n):
        error[j] = 0.0
    for i in range(m):
        for j in range(n):
            error[j] += W[i, j] * y[i]
    for i in range(n):
        for j in range(i + 1):
            value = 0.5 * (P[i, j] - updated[i, j] + P[j, i] - updated[j, i])
            updated[i, j], updated[j, i] = value, value
    return True
