"""Motions of single features over the last tenths of a second, whatever body they are of.

A car that stops is not measured as a moving body, and one that was hidden comes back with few
features. The motion of each feature, against the predicted one of a track, tells which are its own.
"""

from dataclasses import dataclass
from math import log

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import positions
from ovmot.geometry.triangulation import squared_distance
from ovmot.physics import ACCEL_SIGMA_MPS2, gate
from ovmot.types import ScenePoints

_MEMORY_S = 0.8
SPEED_SPREAD = 0.2
"""m/s by which features of one body may differ."""
_LEAST_REACH_MPS, _SPEED_REACH = 1.0, 0.3  # how far off a joining feature's velocity may be
CLEARLY = 2.0 * log(100.0)
"""Difference of squared Mahalanobis distances of which one motion is a hundred times likelier."""


@dataclass(frozen=True, slots=True)
class FeatureMotions:
    """N features now: ids, positions in world and their covariance (N, 3, 3), and the velocity
    (N, 3) of each with its covariance (N, 3, 3); NaN where not known.

    `change` (N,): the part of a possible acceleration in that variance, in any direction. It is
    common to the features of one body.
    """

    feature_id: IntArray
    p_world: FloatArray
    position_cov: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray
    change: FloatArray

    @property
    def known(self) -> BoolArray:
        """Which features (N,) have a velocity."""
        return np.asarray(np.isfinite(self.velocity[:, 0]))


class FeatureHistory:
    """Positions of the present features over the last tenths of a second, in world."""

    def __init__(self) -> None:
        self._stamps = np.empty(0, dtype=np.int64)
        self._feature_id = np.empty(0, dtype=np.int64)
        self._p_world = np.empty((0, 0, 3))
        self._covariance = np.empty((0, 0, 3, 3))
        nothing = np.empty((0, 3))
        self.last = FeatureMotions(
            self._feature_id, nothing, np.empty((0, 3, 3)), nothing, np.empty((0, 3, 3)),
            np.empty(0),
        )  # fmt: skip

    def add(
        self, timestamp_ns: int, points: ScenePoints, T_world_cam0: FloatArray
    ) -> FeatureMotions:
        """Add a frame, drop those that are too old, and return the motions of its features."""
        first = int(np.searchsorted(self._stamps, timestamp_ns - round(1e9 * _MEMORY_S)))
        column = positions(points.feature_id, self._feature_id)
        T, n = len(self._stamps) - first, len(column)
        p_world, covariance = np.full((T + 1, n, 3), np.nan), np.full((T + 1, n, 3, 3), np.nan)
        if len(self._feature_id):
            new = column < 0
            self._p_world[first:].take(column, axis=1, out=p_world[:T])
            self._covariance[first:].take(column, axis=1, out=covariance[:T])
            p_world[:T, new] = np.nan
            covariance[:T, new] = np.nan
        R = T_world_cam0[:3, :3]
        p_world[T] = se3.apply(T_world_cam0, points.p_cam0)
        covariance[T] = R @ points.cov_cam0 @ R.T
        self._stamps = np.append(self._stamps[first:], timestamp_ns)
        self._feature_id, self._p_world, self._covariance = points.feature_id, p_world, covariance
        self.last = self._motions()
        return self.last

    def _motions(self) -> FeatureMotions:
        """Each feature's motion since the earlier time with the least expected squared error.

        The part of the positions' noise falls with the span, that of an acceleration grows.
        """
        n = len(self._feature_id)
        age_s = 1e-9 * (self._stamps[-1] - self._stamps)
        then = np.isfinite(self._p_world[..., 0]) & (age_s > 0.0)[:, None]
        dt = np.where(then, age_s[:, None], np.nan)
        spread = (self._covariance[-1] + self._covariance) / dt[..., None, None] ** 2
        changed = (0.5 * ACCEL_SIGMA_MPS2 * dt) ** 2
        error = np.where(then, np.trace(spread, axis1=2, axis2=3) + 3.0 * changed, np.inf)
        row, columns = np.argmin(error, axis=0), np.arange(n)
        displacement = self._p_world[-1] - self._p_world[row, columns]
        return FeatureMotions(
            self._feature_id,
            self._p_world[-1],
            self._covariance[-1],
            displacement / dt[row, columns, None],
            spread[row, columns] + changed[row, columns, None, None] * np.eye(3),
            changed[row, columns],
        )


def moving_with(
    motions: FeatureMotions, candidate: BoolArray, velocity: FloatArray, velocity_cov: FloatArray
) -> BoolArray:
    """Which of the `candidate` features (N,) have the velocity of a body, and are not at rest.

    `velocity` (3,) of the body with its covariance (3, 3).
    """
    with_body = np.zeros(len(candidate), dtype=np.bool_)
    index = np.flatnonzero(candidate & motions.known)
    if len(index) == 0:
        return with_body
    from_rest, from_body = distances_from_rest_and_body(motions, index, velocity, velocity_cov)
    dv = motions.velocity[index] - velocity
    # within the covariance of a body that is hardly known, everything around it would pass
    near_speed = np.linalg.norm(dv, axis=1) < np.maximum(
        _LEAST_REACH_MPS, _SPEED_REACH * float(np.linalg.norm(velocity))
    )
    same = (from_body < gate(3, 0.99)) & near_speed
    with_body[index] = same & (from_rest > from_body + CLEARLY)
    return with_body


def distances_from_rest_and_body(
    motions: FeatureMotions, index: IntArray, velocity: FloatArray, velocity_cov: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (K,) of features' velocities from rest and from a body's
    velocity (3,) with its covariance (3, 3); NaN where a feature's velocity is not known."""
    C = motions.velocity_cov[index] + SPEED_SPREAD**2 * np.eye(3)
    v = motions.velocity[index]
    return squared_distance(v, C), squared_distance(v - velocity, C + velocity_cov)
