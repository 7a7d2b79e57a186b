"""Updates of the state by a measurement. Those by features are compiled: `update_kernel`."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dgeqrt, dpstrf

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.state import State, box_plus


def ekf_update(
    state: State,
    H: FloatArray,
    columns: IntArray,
    residual: FloatArray,
    variance: FloatArray,
    L: FloatArray | None = None,
) -> State:
    """The state updated by residual = H δ[columns] + n, n ~ N(0, diag(variance)).

    `H` (m, k); `columns` (k,): the error coordinates that H multiplies; `residual` (m,) and
    `variance` (m,), in the units of the measurement and their squares; `L` (m, m): the
    `innovation_factor` of these where the caller has it already.

    With S = L Lᵀ and W = L⁻¹ H P, the gain is K = Wᵀ L⁻¹ and the covariance becomes P - Wᵀ W, which
    stays symmetric, at the cost of m N² (G. Golub & C. Van Loan, sec. 6.5.4). What is only
    considered has no gain: its estimate and its own covariance stay (S. F. Schmidt, 1966).
    """
    if len(residual) == 0:
        return state
    P = state.covariance
    if L is None:
        L = innovation_factor(P[np.ix_(columns, columns)], H, variance)
    W = solve_triangular(L, H @ P[columns], lower=True)
    covariance = P - W.T @ W
    error = W.T @ solve_triangular(L, residual, lower=True)
    considered = slice(*state.considered)
    error[considered], covariance[considered, considered] = 0.0, P[considered, considered]
    return box_plus(state, error, 0.5 * (covariance + covariance.T))


def moved(state: State, error: FloatArray, covariance: FloatArray) -> State:
    """The state by the error vector (N,) and the covariance (N, N) that a kernel has found.

    Raises `FloatingPointError` where the numbers broke down.
    """
    if not np.isfinite(error).all():
        raise FloatingPointError("an update is not finite")
    return box_plus(state, error, covariance)


def innovation_distance(
    state: State, H: FloatArray, columns: IntArray, residual: FloatArray, variance: FloatArray
) -> float:
    """Squared Mahalanobis distance of a residual under the state's covariance: rᵀ S⁻¹ r.

    Arguments as those of `ekf_update`; to be compared with `physics.gate(m, probability)`.
    """
    L = innovation_factor(state.covariance[np.ix_(columns, columns)], H, variance)
    innovation = solve_triangular(L, residual, lower=True)
    return float(innovation @ innovation)


def innovation_factor(P: FloatArray, H: FloatArray, variance: FloatArray) -> FloatArray:
    """Triangular L (m, m) with L Lᵀ = H P Hᵀ + diag(variance); `P` (k, k), `H` (m, k).

    Square root by QR: with P = F Fᵀ, Lᵀ is the R of [(H F)ᵀ; diag(sigma)] (P. Kaminski et al., TAC
    1971). S is not formed: where a row of H is large, rounding would lose the noise, and S would
    have no Cholesky factor. P may be singular, as cloning makes it: F is P's pivoted Cholesky
    factor, of P's rank.
    """
    sigma = np.sqrt(np.maximum(np.diag(P), 0.0))
    scale = np.where(sigma > 0.0, sigma, 1.0)  # units differ: the rank is that of correlations
    C, pivots, rank, _ = dpstrf(P / np.outer(scale, scale), lower=1)
    HF = (H * scale)[:, pivots - 1] @ np.tril(C)[:, :rank]
    stacked = np.concatenate([HF.T, np.diag(np.sqrt(variance))])
    return triangular_part(stacked).T


def triangular_part(A: FloatArray, *, block: int = 32) -> FloatArray:
    """The R (min(m, n), n) of A = Q R, with A (m, n).

    By LAPACK's recursive QR (E. Elmroth & F. Gustavson, IBM J. R&D 2000) in blocks of `block`
    columns: for tall matrices on one thread two to three times as fast as `dgeqrf`, and as stable.
    """
    factored, _, _ = dgeqrt(min(block, *A.shape), A)
    return np.triu(factored[: min(A.shape)])
