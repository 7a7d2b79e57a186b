"""The one place where a measurement changes the covariance."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dgeqrt, dpstrf
from scipy.special import chdtri

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.state import State, box_plus

_QR_BLOCK = 32


def ekf_update(
    state: State,
    H: FloatArray,
    columns: IntArray,
    residual: FloatArray,
    variance: FloatArray,
    L: FloatArray | None = None,
) -> State:
    """Correct the state by residual = H δ[columns] + n, n ~ N(0, diag(variance)).

    `H` (m, k), `columns` (k,): which error coordinates H multiplies, `residual` (m,), `variance`
    (m,); `L`: the `innovation_factor` of these, if it is known already. With W = L⁻¹ H P the
    covariance becomes P - Wᵀ W, which stays symmetric, at the cost of m N² (G. Golub & C. Van Loan,
    sec. 6.5.4).
    """
    if len(residual) == 0:
        return state
    P = state.covariance
    if L is None:
        L = innovation_factor(P[np.ix_(columns, columns)], H, variance)
    W = solve_triangular(L, H @ P[columns], lower=True)
    moved = box_plus(state, W.T @ solve_triangular(L, residual, lower=True))
    updated = P - W.T @ W
    return replace(moved, covariance=0.5 * (updated + updated.T))


def innovation_distance(
    state: State, H: FloatArray, columns: IntArray, residual: FloatArray, variance: FloatArray
) -> float:
    """Squared Mahalanobis distance of a residual under the state's covariance; see ekf_update."""
    L = innovation_factor(state.covariance[np.ix_(columns, columns)], H, variance)
    innovation = solve_triangular(L, residual, lower=True)
    return float(innovation @ innovation)


def innovation_factor(P: FloatArray, H: FloatArray, variance: FloatArray) -> FloatArray:
    """Triangular L (m, m) with L Lᵀ = H P Hᵀ + diag(variance); `P` (k, k), `H` (m, k).

    By QR of its square root: with P = F Fᵀ, Lᵀ is the R of [(H F)ᵀ; diag(sigma)] (P. Kaminski
    et al., TAC 1971). Where large rows of H swallow the noise, the rounded sum has no factor. P
    may be singular, as a new clone makes it: its own factor is pivoted, and of P's rank.
    """
    sigma = np.sqrt(np.maximum(np.diag(P), 0.0))
    scale = np.where(sigma > 0.0, sigma, 1.0)  # units are far apart: rank is that of correlations
    C, pivots, rank, _ = dpstrf(P / np.outer(scale, scale), lower=1)
    HF = (H * scale)[:, pivots - 1] @ np.tril(C)[:, :rank]
    stacked = np.concatenate([HF.T, np.diag(np.sqrt(variance))])
    return triangular_part(stacked).T


def compress(H: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same measurement, of equal variances, in at most as many rows as columns.

    QR of [H | r]: the rows of Qᵀr beyond H's rank hold only noise (A. Mourikis & S. Roumeliotis,
    ICRA 2007, eq. 26-28).
    """
    m, n = H.shape
    if m <= n:
        return H, residual
    R = triangular_part(np.column_stack([H, residual]))
    return R[:n, :n], R[:n, n]


def triangular_part(A: FloatArray) -> FloatArray:
    """The R (min(m, n), n) of A = Q R, with A (m, n).

    By LAPACK's recursive blocks (E. Elmroth & F. Gustavson, IBM J. R&D 2000): for tall matrices on
    one thread two to three times as quick as the usual routine, and as stable.
    """
    factored, _, _ = dgeqrt(min(_QR_BLOCK, *A.shape), A)
    return np.triu(factored[: min(A.shape)])


@lru_cache(maxsize=4096)
def chi2_bound(dof: int, probability: float = 0.95) -> float:
    """Quantile of the chi-squared distribution."""
    return float(chdtri(dof, 1.0 - probability))
