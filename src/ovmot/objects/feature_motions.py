"""Features that were seen some tenths of a second ago and are seen now: how each has moved.

A car that stops has no motion to be found by, and one that was hidden comes back with few features.
What is known of a track then tells which features are its own.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import positions
from ovmot.geometry.triangulation import inverse_3x3, squared_distance
from ovmot.types import ScenePoints

_MIN_FEATURES = 3
_MOST_FEATURES = 24  # of one body: more tell little more
_AGREE_SIGMAS = 3.0
_MEMORY_S = 0.8
_SHORTEST_S = 0.05
_ACCEL_SIGMA = 2.0  # m/s²: how much a road user's velocity changes
_SPEED_SPREAD = 0.2  # m/s by which features of one body may differ
_CHOSEN_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_LEAST_REACH_MPS, _SPEED_REACH = 1.0, 0.3  # how far off a joining feature's velocity may be
_BETTER_THAN_REST = 9.0  # squared sigmas by which a body's motion must explain more than rest


@dataclass(frozen=True, slots=True)
class FeatureMotions:
    """N features now: ids, positions in world and their covariance (N, 3, 3), and the velocity
    (N, 3) of each with its covariance (N, 3, 3); NaN where not known.

    `change` (N,): the part of its variance, in any direction, that a change of velocity on the way
    makes. Features of one body have that in common.
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


@dataclass(frozen=True, slots=True)
class UnmeasuredBody:
    """Middle, velocity and their covariance (6, 6) of features that moved together.

    `strayed`: the ids of those asked for that went another way.
    """

    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    strayed: IntArray


class Sightings:
    """Where the present features were over the last tenths of a second, in the world."""

    def __init__(self) -> None:
        self._stamps = np.empty(0, dtype=np.int64)
        self._feature_id = np.empty(0, dtype=np.int64)
        self._p_world = np.empty((0, 0, 3))
        self._covariance = np.empty((0, 0, 3, 3))
        nothing = np.empty((0, 3))
        self.last = FeatureMotions(
            self._feature_id,
            nothing,
            np.empty((0, 3, 3)),
            nothing,
            np.empty((0, 3, 3)),
            np.empty(0),
        )

    def add(self, timestamp_ns: int, seen: ScenePoints, T_world_cam0: FloatArray) -> FeatureMotions:
        """Take a frame in, let those go that are too old, and say how its features moved."""
        first = int(np.searchsorted(self._stamps, timestamp_ns - round(1e9 * _MEMORY_S)))
        column = positions(seen.feature_id, self._feature_id)
        T, n = len(self._stamps) - first, len(column)
        p_world, covariance = np.full((T + 1, n, 3), np.nan), np.full((T + 1, n, 3, 3), np.nan)
        if len(self._feature_id):
            new = column < 0
            self._p_world[first:].take(column, axis=1, out=p_world[:T])
            self._covariance[first:].take(column, axis=1, out=covariance[:T])
            p_world[:T, new] = np.nan
            covariance[:T, new] = np.nan
        R = T_world_cam0[:3, :3]
        p_world[T] = se3.apply(T_world_cam0, seen.p_cam0)
        covariance[T] = R @ seen.cov_cam0 @ R.T
        self._stamps = np.append(self._stamps[first:], timestamp_ns)
        self._feature_id, self._p_world, self._covariance = seen.feature_id, p_world, covariance
        self.last = self._motions()
        return self.last

    def _motions(self) -> FeatureMotions:
        """From that earlier place of each feature to the present one which tells most.

        The longer the way, the less its noise matters, and the more a change of velocity does.
        """
        n = len(self._feature_id)
        age_s = 1e-9 * (self._stamps[-1] - self._stamps)
        then = np.isfinite(self._p_world[..., 0]) & (age_s > _SHORTEST_S)[:, None]
        dt = np.where(then, age_s[:, None], np.nan)
        spread = (self._covariance[-1] + self._covariance) / dt[..., None, None] ** 2
        changed = (0.5 * _ACCEL_SIGMA * dt) ** 2
        told = np.where(then, np.trace(spread, axis1=2, axis2=3) + 3.0 * changed, np.inf)
        row, columns = np.argmin(told, axis=0), np.arange(n)
        moved = self._p_world[-1] - self._p_world[row, columns]
        return FeatureMotions(
            self._feature_id,
            self._p_world[-1],
            self._covariance[-1],
            moved / dt[row, columns, None],
            spread[row, columns] + changed[row, columns, None, None] * np.eye(3),
            changed[row, columns],
        )


def follow(motions: FeatureMotions, own: BoolArray, velocity: FloatArray) -> UnmeasuredBody | None:
    """What a body's `own` features (N,) say of it, whose velocity (3,) was about so before.

    None where fewer than three of them are known and moved alike.
    """
    index = np.flatnonzero(own & motions.known)
    if len(index) < _MIN_FEATURES:
        return None
    index = index[:: -(-len(index) // _MOST_FEATURES)]
    v, C = motions.velocity[index], motions.velocity_cov[index]
    alike = _agreeing(v, C, velocity)
    if alike.sum() < _MIN_FEATURES:
        return None
    return _as_one(motions, index[alike], motions.feature_id[index[~alike]])


def join(
    motions: FeatureMotions, near: BoolArray, velocity: FloatArray, velocity_cov: FloatArray
) -> BoolArray:
    """Which features (N,) of those `near` a body go as it goes, and do not rest.

    `velocity` (3,) of the body with its covariance (3, 3).
    """
    joins = np.zeros(len(near), dtype=np.bool_)
    index = np.flatnonzero(near & motions.known)
    if len(index) == 0:
        return joins
    at_rest, with_body = rest_or_body(motions, index, velocity, velocity_cov)
    off = motions.velocity[index] - velocity
    # an unsure body would take up anything around it
    near_speed = np.linalg.norm(off, axis=1) < np.maximum(
        _LEAST_REACH_MPS, _SPEED_REACH * float(np.linalg.norm(velocity))
    )
    alike = (with_body < _CHOSEN_GATE) & near_speed
    joins[index] = alike & (at_rest > with_body + _BETTER_THAN_REST)
    return joins


def rest_or_body(
    motions: FeatureMotions, index: IntArray, velocity: FloatArray, velocity_cov: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared sigmas (K,) by which features (K,) miss rest, and a body's motion; NaN if unknown.

    `velocity` (3,) of the body with its covariance (3, 3).
    """
    C = motions.velocity_cov[index] + _SPEED_SPREAD**2 * np.eye(3)
    v = motions.velocity[index]
    off = v - velocity
    return squared_distance(v, C), squared_distance(off, C + velocity_cov)


def body_of(motions: FeatureMotions, own: BoolArray) -> UnmeasuredBody:
    """The body that features (N,), known to move together, make up."""
    return _as_one(motions, np.flatnonzero(own), np.empty(0, dtype=np.int64))


def _as_one(motions: FeatureMotions, index: IntArray, strayed: IntArray) -> UnmeasuredBody:
    W = inverse_3x3(motions.velocity_cov[index])
    P_v = inverse_3x3(W.sum(0))
    mean = P_v @ (W @ motions.velocity[index][..., None])[..., 0].sum(0)
    points = motions.p_world[index]
    P = np.zeros((6, 6))
    P[:3, :3] = motions.position_cov[index].mean(0) / len(index) + 0.01 * np.eye(3)
    P[3:, 3:] = P_v + motions.change[index].mean() * np.eye(3)
    return UnmeasuredBody(0.5 * (points.min(axis=0) + points.max(axis=0)), mean, P, strayed)


def _agreeing(velocity: FloatArray, C: FloatArray, before: FloatArray) -> BoolArray:
    """The largest set (N,) of features whose velocities are those of one of them."""
    apart = velocity[:, None] - velocity[None]
    spread = C[:, None] + C[None] + _SPEED_SPREAD**2 * np.eye(3)
    votes = squared_distance(apart, spread) < _AGREE_SIGMAS**2
    best = votes.sum(1)
    # among equals the one that goes as the body did
    off = np.linalg.norm(velocity - before, axis=1)
    return np.asarray(votes[int(np.lexsort((off, -best))[0])])
