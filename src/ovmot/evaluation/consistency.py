"""Is a covariance honest? Normalized errors squared, and the chi-squared bounds they should keep.

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, chapter 5.4. Errors are those of docs/conventions.md: rotations on the right,
R_true = R_est · exp(δθ), positions p_true = p_est + δp in the world.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray

_SINGULAR = 1e-13  # squared pivot of a correlation matrix; below it only rounding is left


@dataclass(frozen=True, slots=True)
class Nis:
    """Innovations squared (N,), normalized, and the degrees of freedom (N,) of each."""

    values: FloatArray
    dof: IntArray


@dataclass(frozen=True, slots=True)
class Average:
    """A mean over `count` values; `undefined` values (NaN) were left out of it.

    `share_inside` is the share of them within the chi-squared bounds of a single value.
    """

    mean: float
    share_inside: float
    count: int
    undefined: int


def pose_errors(T_reference: FloatArray, T_estimate: FloatArray) -> FloatArray:
    """Errors (N, 6) of poses (N, 4, 4): δθ = log(R_estᵀ R_true) in rad, δp = p_true - p_est in m.

    Both trajectories must be in one world.
    """
    R_reference, R_estimate = T_reference[..., :3, :3], T_estimate[..., :3, :3]
    turn = so3.log(np.swapaxes(R_estimate, -1, -2) @ R_reference)
    return np.concatenate([turn, T_reference[..., :3, 3] - T_estimate[..., :3, 3]], axis=-1)


def turn_world(covariance: FloatArray, R_new_old: FloatArray) -> FloatArray:
    """Covariances (N, 3m, 3m) over rotation and m - 1 world vectors, in a turned world.

    A right perturbation lives in the body frame, which does not turn with the world; position
    and velocity do.
    """
    size = covariance.shape[-1]
    turn = np.kron(np.eye(size // 3), R_new_old)
    turn[:3, :3] = np.eye(3)
    turned: FloatArray = turn @ covariance @ turn.T
    return turned


def nees(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    """eᵀ P⁻¹ e (N,) of errors (N, k) and covariances (N, k, k), by Cholesky.

    NaN where an error or a covariance is not known, or a covariance is not positive definite.
    """
    return _normalized_squares(errors, covariance)


def nis(innovations: Sequence[FloatArray], covariances: Sequence[FloatArray]) -> Nis:
    """NIS of innovations, each (k,) with its covariance (k, k), where k may change."""
    rows = [
        _normalized_squares(e[None], S[None])[0]
        for e, S in zip(innovations, covariances, strict=True)
    ]
    dof = [len(innovation) for innovation in innovations]
    return Nis(np.array(rows, dtype=np.float64), np.array(dof, dtype=np.int64))


def chi_squared_bounds(dof: int, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided bounds of one normalized square with so many degrees of freedom."""
    tail = 0.5 * (1.0 - probability)
    return float(chdtri(dof, 1.0 - tail)), float(chdtri(dof, tail))


def average_bounds(
    dof: int, n_runs: int, n_steps: int = 1, probability: float = 0.95
) -> tuple[float, float]:
    """Bounds of the mean of `n_runs` x `n_steps` independent values of `dof` each (5.4.2).

    Errors of one run at successive steps are correlated: give `n_steps` more than 1 for white
    quantities only, such as NIS.
    """
    count = n_runs * n_steps
    low, high = chi_squared_bounds(dof * count, probability)
    return low / count, high / count


def average_over_runs(values: FloatArray) -> FloatArray:
    """Mean (N,) at each step of NEES (M, N) of M runs; NaN values are left out of it."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def average(values: FloatArray, dof: int, probability: float = 0.95) -> Average | None:
    """Mean and share within bounds of values (N,) of one `dof`; None where none is known."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return None
    low, high = chi_squared_bounds(dof, probability)
    inside = float(np.mean((known >= low) & (known <= high)))
    return Average(float(known.mean()), inside, len(known), len(values) - len(known))


def normalized_average(
    squares: Nis, probability: float = 0.95
) -> tuple[float, tuple[float, float]] | None:
    """Σ NIS / Σ dof, ideally 1, and its bounds; innovations may differ in dimension."""
    known = np.isfinite(squares.values) & (squares.dof > 0)
    total = int(squares.dof[known].sum())
    if total == 0:
        return None
    low, high = chi_squared_bounds(total, probability)
    return float(squares.values[known].sum()) / total, (low / total, high / total)


def _normalized_squares(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    """eᵀ P⁻¹ e (N,) of errors (N, k), NaN where P is not positive definite or anything is NaN.

    P is brought to a correlation matrix first, so that units do not decide what is singular. Its
    Cholesky factor L is made column by column for all at once, and with it y = L⁻¹ e.
    """
    n, k = errors.shape
    L = np.zeros((n, k, k))
    y = np.zeros((n, k))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        C = covariance / (sigma[:, :, None] * sigma[:, None, :])
        for j in range(k):
            before = L[:, :, :j] @ L[:, j, :j, None]
            pivot = C[:, j, j] - before[:, j, 0]
            root = np.sqrt(np.where(pivot >= _SINGULAR, pivot, np.nan))
            L[:, j:, j] = (C[:, j:, j] - before[:, j:, 0]) / root[:, None]
            known = np.einsum("ni,ni->n", L[:, j, :j], y[:, :j])
            y[:, j] = (errors[:, j] / sigma[:, j] - known) / root
        squares: FloatArray = np.einsum("ni,ni->n", y, y)
    return np.where(np.isfinite(squares), squares, np.nan)
