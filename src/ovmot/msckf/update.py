"""The one place where a measurement changes the covariance."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, qr, solve_triangular
from scipy.special import chdtri

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.msckf.state import State, box_plus


def ekf_update(
    state: State, H: FloatArray, columns: IntArray, residual: FloatArray, variance: FloatArray
) -> State:
    """Correct the state by residual = H δ[columns] + n, n ~ N(0, diag(variance)).

    `H` (m, k), `columns` (k,): which error coordinates H multiplies, `residual` (m,), `variance`
    (m,). With S = L Lᵀ and W = P Hᵀ L⁻ᵀ the covariance becomes P - W Wᵀ, which stays symmetric, at
    the cost of m N² (G. Golub & C. Van Loan, sec. 6.5.4).
    """
    if len(residual) == 0:
        return state
    P = state.covariance
    PHt = P[:, columns] @ H.T
    L = cholesky(H @ PHt[columns] + np.diag(variance), lower=True)
    W = solve_triangular(L, PHt.T, lower=True)
    moved = box_plus(state, W.T @ solve_triangular(L, residual, lower=True))
    updated = P - W.T @ W
    return replace(moved, covariance=0.5 * (updated + updated.T))


def innovation_distance(
    state: State, H: FloatArray, columns: IntArray, residual: FloatArray, variance: FloatArray
) -> float:
    """Squared Mahalanobis distance of a residual under the state's covariance; see ekf_update."""
    S = H @ state.covariance[np.ix_(columns, columns)] @ H.T + np.diag(variance)
    return float(residual @ cho_solve(cho_factor(S, lower=True), residual))


def compress(H: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same measurement, of equal variances, in at most as many rows as columns.

    QR of [H | r]: the rows of Qᵀr beyond H's rank hold only noise (A. Mourikis & S. Roumeliotis,
    ICRA 2007, eq. 26-28).
    """
    m, n = H.shape
    if m <= n:
        return H, residual
    stacked = np.column_stack([H, residual])
    R = np.asarray(qr(stacked, mode="r", overwrite_a=True, check_finite=False)[0], np.float64)
    return R[:n, :n], R[:n, n]


@lru_cache(maxsize=4096)
def chi2_bound(dof: int, probability: float = 0.95) -> float:
    """Quantile of the chi-squared distribution."""
    return float(chdtri(dof, 1.0 - probability))
