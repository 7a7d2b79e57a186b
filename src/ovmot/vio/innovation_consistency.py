"""Do the features of an update agree with the IMU? Where most move together, the IMU decides.

Each feature may pass its own gate and all of them together still ask for a motion that the IMU has
ruled out: a lorry that fills the view and pulls away is as rigid as a street. With the whitened
innovation y = L⁻¹ r ~ N(0, I), S = L Lᵀ, the update moves the velocity by Wᵀ y, W = L⁻¹ H P_v. So
y, projected on the three columns of W, is all that the update says about velocity; its squared
length is chi-squared with 3 degrees of freedom.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.vio.state import VELOCITY, State
from ovmot.vio.update import chi2_bound, compress, innovation_factor

_SLACK = 2.0  # on the bound: errors of slid patches are not white
_CERTAIN = 1.0 - 1e-5
_MIN_FEATURES = 3


@dataclass(frozen=True, slots=True)
class ConsistentUpdate:
    """How much each feature's rows count in an update of all together, `share` (F,), 0 to 1; and
    that update, `H` (m, k) and `residual` (m,) whitened, with its `innovation_factor` L (m, m)."""

    share: FloatArray
    H: FloatArray
    residual: FloatArray
    L: FloatArray


def velocity_distance(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray, L: FloatArray
) -> float:
    """Squared distance, 3 degrees, of the velocity that residual = H δ[columns] + n asks for from
    the state's own, in units of what it may differ.

    `H` (m, k), `residual` (m,), n ~ N(0, I); `L` their `innovation_factor`.
    """
    innovation = solve_triangular(L, residual, lower=True)
    W = solve_triangular(L, H @ state.covariance[columns, VELOCITY], lower=True)
    asked = qr(W, mode="economic")[0].T @ innovation
    return float(asked @ asked)


def innovation_consistency(
    state: State,
    H: FloatArray,
    residual: FloatArray,
    columns: IntArray,
    distance: FloatArray,
    passed: BoolArray,
) -> ConsistentUpdate | None:
    """The update by all features that agree with each other and the prediction; None by too few.

    `H` (F, M, k) and `residual` (F, M) whitened, rows of zeros where nothing was seen; `distance`
    (F,), the `innovation_distances`, and `passed` (F,), their own gates. Beyond its expected size a
    feature's innovation counts linearly only (P. Huber, 1964). Where their common motion does not
    agree with the prediction, the half that is nearest to the prediction, each by itself, is asked,
    and so on; the others have no share.
    """
    kept = np.flatnonzero(passed)
    n_rows = (np.abs(H[kept]).max(axis=2, initial=0.0) > 0.0).sum(1)
    size = np.sqrt(distance[kept] / n_rows)  # in sigmas: 1 where it is as expected
    weight = 1.0 / np.sqrt(np.maximum(size, 1.0))
    nearest = np.argsort(size, kind="stable")
    kept, weight = kept[nearest], weight[nearest]
    P = state.covariance[np.ix_(columns, columns)]
    n = len(kept)
    while n >= max(min(_MIN_FEATURES, len(kept)), 1):
        share = np.zeros(len(passed))
        share[kept[:n]] = weight[:n]
        rows = compress(*_scaled(H, residual, share))
        L = innovation_factor(P, rows[0], np.ones(len(rows[1])))
        if velocity_distance(state, *rows, columns, L) < _SLACK * chi2_bound(3, _CERTAIN):
            return ConsistentUpdate(share, *rows, L)
        n //= 2
    return None


def _scaled(
    H: FloatArray, residual: FloatArray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The rows (m, k) and (m,) of all features with a share, scaled by it; rows of zeros go."""
    taken = share > 0.0
    rows = (H[taken] * share[taken, None, None]).reshape(-1, H.shape[2])
    real = np.abs(rows).max(axis=1, initial=0.0) > 0.0
    return rows[real], (residual[taken] * share[taken, None]).ravel()[real]
