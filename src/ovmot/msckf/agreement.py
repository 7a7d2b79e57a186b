"""Do the features of an update agree with the IMU? Where most of them move together, the IMU decides.

Each feature may pass its own gate and all of them together still ask for a motion that the IMU has
ruled out: a lorry that fills the view and pulls away is as rigid as a street. With the whitened innovation
y = L⁻¹ r ~ N(0, I), S = L Lᵀ, the update moves the velocity by Wᵀ y, W = L⁻¹ H P_v. So y, projected on
the three columns of W, is all that the update says about velocity; its squared length is chi-squared
with 3 degrees of freedom.
"""

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.msckf.state import VELOCITY, State
from ovmot.msckf.update import chi2_bound, compress

_SLACK = 2.0  # on the bound: errors of slid patches are not white
_CERTAIN = 1.0 - 1e-5
_MIN_FEATURES = 3


def velocity_distance(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray
) -> float:
    """Squared distance, 3 degrees, of the velocity that residual = H δ[columns] + n asks for from
    the state's own, in units of what it may differ; `H` (m, k), `residual` (m,), n ~ N(0, I)."""
    P = state.covariance
    S = H @ P[np.ix_(columns, columns)] @ H.T
    L = cholesky(S + np.eye(len(S)), lower=True)
    innovation = solve_triangular(L, residual, lower=True)
    W = solve_triangular(L, H @ P[columns, VELOCITY], lower=True)
    asked = qr(W, mode="economic")[0].T @ innovation
    return float(asked @ asked)


def agreeing(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray, passed: BoolArray
) -> BoolArray:
    """Which of the features that passed their gates (F,) an update may take together.

    `H` (F, M, k) and `residual` (F, M) whitened, rows of zeros where nothing was seen. All of them
    where their common motion agrees with the prediction; else the half that is nearest to the
    prediction, each by itself, is asked, and so on; none where no subset is left.
    """
    kept = np.flatnonzero(passed)
    if not len(kept):
        return passed
    P = state.covariance[np.ix_(columns, columns)]
    S = H[kept] @ P @ np.swapaxes(H[kept], 1, 2) + np.eye(H.shape[1])
    r = residual[kept]
    own = (r * np.linalg.solve(S, r[..., None])[..., 0]).sum(1)
    own /= (np.abs(H[kept]).max(axis=2) > 0.0).sum(1)
    kept = kept[np.argsort(own, kind="stable")]
    bound = _SLACK * chi2_bound(3, _CERTAIN)
    while len(kept) >= min(_MIN_FEATURES, passed.sum()):
        rows = H[kept].reshape(-1, H.shape[2])
        real = np.abs(rows).max(axis=1) > 0.0
        system = compress(rows[real], residual[kept].ravel()[real])
        if velocity_distance(state, *system, columns) < bound:
            break
        kept = kept[: len(kept) // 2]
    else:
        kept = kept[:0]
    out = np.zeros_like(passed)
    out[kept] = True
    return out
