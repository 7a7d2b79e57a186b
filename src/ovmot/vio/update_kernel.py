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
def factor_with_rows(A: FloatArray) -> None:
    """Cholesky factor L of I + M, in place, and L⁻¹ of the rows below.

    The lower triangle of the first n rows of A (., n) is I + M with M positive semidefinite; each
    row below is a vector b (n,), replaced by L⁻¹ b. No pivot of such a matrix is below 1: where
    rounding of large entries has lost the noise, it is put back.
    """
    n = A.shape[1]
    for i in range(len(A)):
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


@part
def give_weights(size: FloatArray, order: IntArray, count: int, weight: FloatArray) -> None:
    """Huber's weights (F,) of the `count` first in `order` (F,), by their sizes; 0 for others."""
    for f in range(len(weight)):
        weight[f] = 0.0
    for k in range(count):
        weight[order[k]] = 1.0 / math.sqrt(max(size[order[k]], 1.0))


@reordered_part
def orthonormalize_rows(A: FloatArray) -> None:
    """Make A's rows orthonormal, in place, by Gram-Schmidt, each row twice.

    A row that is in the span of those before it becomes zero.
    """
    m = A.shape[1]
    for a in range(len(A)):
        before, square = 0.0, 0.0
        for k in range(m):
            before += A[a, k] * A[a, k]
        for b in range(2 * a):
            along = 0.0
            for k in range(m):
                along += A[b % a, k] * A[a, k]
            for k in range(m):
                A[a, k] -= along * A[b % a, k]
        for k in range(m):
            square += A[a, k] * A[a, k]
        scale = 1.0 / math.sqrt(square) if square > 1e-24 * before else 0.0
        for k in range(m):
            A[a, k] *= scale


@reordered_part
def explained_square(A: FloatArray) -> float:
    """Squared length of what of the last row of A (4, m) is in the span of the others, in place."""
    total, last = 0.0, len(A) - 1
    orthonormalize_rows(A[:last])
    for a in range(last):
        along = 0.0
        for k in range(A.shape[1]):
            along += A[a, k] * A[last, k]
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
    considered: tuple[int, int],
    velocity_bound: float,
    error: FloatArray,
    updated: FloatArray,
) -> bool:
    """Update by m rows of noise 1, unless the velocity that they ask for is beyond the bound.

    `HP` (m, N), `S` (m + 4, m): see `innovation`; S is changed in place. `considered`: first and
    one past the last of the coordinates that are only considered. The error vector (N,) and the new
    covariance (N, N) are filled in; False, and they are not, beyond `velocity_bound`. As
    `update.ekf_update`: S = L Lᵀ, W = L⁻¹ H P, the covariance becomes P - Wᵀ W.
    """
    m, n = HP.shape
    for i in range(m):
        for a in range(_VELOCITY_DOF):
            S[m + a, i] = HP[i, _VELOCITY + a]
        S[m + _VELOCITY_DOF, i] = residual[i]
    factor_with_rows(S)
    y = S[m + _VELOCITY_DOF]
    if not explained_square(S[m:]) < velocity_bound:  # W for the velocity, and y = L⁻¹ r
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
    for i in range(considered[0], considered[1]):
        error[i] = 0.0
        for j in range(considered[0], considered[1]):
            updated[i, j] = P[i, j]
    return True
