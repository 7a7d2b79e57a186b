"""Do the features of an update agree with the IMU? Where most move together, the IMU decides.

Each feature may pass its own gate and all of them together still ask for a velocity that the IMU
rules out: a lorry that fills the view and drives off is as rigid as a street. With the whitened
innovation y = L⁻¹ r ~ N(0, I), S = L Lᵀ, the update changes the velocity by Wᵀ y, W = L⁻¹ H P_v.
So the projection of y on the three columns of W is all that the update says about velocity; its
squared length is chi-squared with 3 degrees of freedom.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.physics import VARIANCE_FACTOR, gate
from ovmot.vio.state import VELOCITY, State
from ovmot.vio.update import compress, innovation_factor

_PROBABILITY = 1.0 - 1e-5
_VELOCITY_DOF = VELOCITY.stop - VELOCITY.start


@dataclass(frozen=True, slots=True)
class ConsistentUpdate:
    """One update by all features that are consistent.

    `weight` (F,): factor on each feature's rows, 0 for those left out, up to 1; `H` (m, k) and
    `residual` (m,): the weighted rows, compressed and whitened; `L` (m, m): their
    `innovation_factor`.
    """

    weight: FloatArray
    H: FloatArray
    residual: FloatArray
    L: FloatArray


def velocity_distance(
    state: State, H: FloatArray, residual: FloatArray, columns: IntArray, L: FloatArray
) -> float:
    """Squared Mahalanobis distance (3 dof) between the velocity that an update asks for and the
    predicted one.

    residual = H δ[columns] + n, n ~ N(0, I): `H` (m, k), `residual` (m,), `columns` (k,); `L`
    (m, m): their `innovation_factor`.
    """
    innovation = solve_triangular(L, residual, lower=True)
    W = solve_triangular(L, H @ state.covariance[columns, VELOCITY], lower=True)
    projected = qr(W, mode="economic")[0].T @ innovation
    return float(projected @ projected)


def innovation_consistency(
    state: State,
    H: FloatArray,
    residual: FloatArray,
    columns: IntArray,
    distance: FloatArray,
    dof: IntArray,
    passed: BoolArray,
) -> ConsistentUpdate | None:
    """The update by all features that are consistent with each other and with the prediction.

    `H` (F, M, k) and `residual` (F, M): whitened, rows of zeros where nothing was seen; `distance`
    (F,): squared Mahalanobis distance of each feature's innovation, and `dof` (F,) its degrees of
    freedom; `passed` (F,): features that passed their own gate. None where too few are consistent.

    A feature whose innovation is larger than expected gets Huber's weight (P. Huber, 1964). Where
    the velocity that all ask for is beyond the gate, the half of them that is nearest to the
    prediction is tried, and so on; the others get weight 0.
    """
    candidates = np.flatnonzero(passed)
    normalized = np.sqrt(distance[candidates] / dof[candidates])  # 1 where it is as expected
    weights = 1.0 / np.sqrt(np.maximum(normalized, 1.0))
    nearest = np.argsort(normalized, kind="stable")
    candidates, weights = candidates[nearest], weights[nearest]
    P = state.covariance[np.ix_(columns, columns)]
    n = len(candidates)
    # fewer features than components of the velocity cannot contradict each other
    while n >= max(min(_VELOCITY_DOF, len(candidates)), 1):
        weight = np.zeros(len(passed))
        weight[candidates[:n]] = weights[:n]
        rows = compress(*_weighted_rows(H, residual, weight))
        L = innovation_factor(P, rows[0], np.ones(len(rows[1])))
        bound = VARIANCE_FACTOR * gate(_VELOCITY_DOF, _PROBABILITY)
        if velocity_distance(state, *rows, columns, L) < bound:
            return ConsistentUpdate(weight, *rows, L)
        n //= 2
    return None


def _weighted_rows(
    H: FloatArray, residual: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows (m, k) and residuals (m,) of the features with a weight, scaled by it; no zero rows."""
    kept = weight > 0.0
    rows = (H[kept] * weight[kept, None, None]).reshape(-1, H.shape[2])
    seen = np.abs(rows).max(axis=1, initial=0.0) > 0.0
    return rows[seen], (residual[kept] * weight[kept, None]).ravel()[seen]
