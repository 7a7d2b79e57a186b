"""Do the features of an update agree with the IMU? Where most move together, the IMU decides.

Each feature may pass its own gate and all of them together still ask for a motion that the IMU has
ruled out: a lorry that fills the view and pulls away is as rigid as a street. With the whitened
innovation y = L⁻¹ r ~ N(0, I), S = L Lᵀ, the update moves the velocity by Wᵀ y, W = L⁻¹ H P_v. So
y, projected on the three columns of W, is all that the update says about velocity; its squared
length is chi-squared with 3 degrees of freedom.
"""

import numpy as np
from scipy.linalg import qr, solve_triangular

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.msckf.state import VELOCITY, State
from ovmot.msckf.update import chi2_bound, compress, innovation_factor

_SLACK = 2.0  # on the bound: errors of slid patches are not white
_CERTAIN = 1.0 - 1e-5
_MIN_FEATURES = 3


def velocity_distance(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray
) -> float:
    """Squared distance, 3 degrees, of the velocity that residual = H δ[columns] + n asks for from
    the state's own, in units of what it may differ; `H` (m, k), `residual` (m,), n ~ N(0, I)."""
    P = state.covariance
    L = innovation_factor(P[np.ix_(columns, columns)], H, np.ones(len(residual)))
    innovation = solve_triangular(L, residual, lower=True)
    W = solve_triangular(L, H @ P[columns, VELOCITY], lower=True)
    asked = qr(W, mode="economic")[0].T @ innovation
    return float(asked @ asked)


def shares(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray, passed: BoolArray
) -> FloatArray:
    """By how much (F,) each feature's rows are to be scaled in an update of all together, 0 to 1.

    `H` (F, M, k) and `residual` (F, M) whitened, rows of zeros where nothing was seen; `passed`
    (F,) their own gates. Beyond its expected size a feature's innovation counts linearly only
    (P. Huber, 1964). Where their common motion does not agree with the prediction, the half that
    is nearest to the prediction, each by itself, is asked, and so on; the others have no share.
    """
    out = np.zeros(len(passed))
    kept = np.flatnonzero(passed)
    if not len(kept):
        return out
    size = _innovation_size(state, H[kept], residual[kept], columns)
    out[kept] = 1.0 / np.sqrt(np.maximum(size, 1.0))
    kept = kept[np.argsort(size, kind="stable")]
    least = min(_MIN_FEATURES, len(kept))
    while len(kept) >= least and not _agree(state, H[kept], residual[kept], columns, out[kept]):
        kept = kept[: len(kept) // 2]
    out[np.setdiff1d(np.arange(len(out)), kept if len(kept) >= least else [])] = 0.0
    return out


def scaled(H: FloatArray, residual: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rows (m, k) and (m,) of all features with a share, scaled by it; rows of zeros go."""
    taken = share > 0.0
    rows = (H[taken] * share[taken, None, None]).reshape(-1, H.shape[2])
    real = np.abs(rows).max(axis=1, initial=0.0) > 0.0
    return rows[real], (residual[taken] * share[taken, None]).ravel()[real]


def _innovation_size(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray
) -> FloatArray:
    """Each feature's (F,) innovation in sigmas, over all its rows: 1 where it is as expected."""
    P = state.covariance[np.ix_(columns, columns)]
    S = H @ P @ np.swapaxes(H, 1, 2) + np.eye(H.shape[1])
    distance = (residual * np.linalg.solve(S, residual[..., None])[..., 0]).sum(1)
    n_rows = (np.abs(H).max(axis=2) > 0.0).sum(1)
    size: FloatArray = np.sqrt(distance / n_rows)
    return size


def _agree(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray, share: FloatArray
) -> bool:
    system = compress(*scaled(H, residual, share))
    return velocity_distance(state, *system, columns) < _SLACK * chi2_bound(3, _CERTAIN)
