"""Features that were seen some tenths of a second ago and are seen now: how each has moved.

A car that stops has no motion to be found by, and one that was hidden comes back with few features.
What is known of a track then tells which features are its own.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.types import ScenePoints

_MIN_FEATURES = 3
_MOST_FEATURES = 24  # of one body: more tell little more
_AGREE_SIGMAS = 3.0
_MEMORY_S = 0.8
_SHORTEST_S = 0.05
_SPEED_SPREAD = 0.2  # m/s by which features of one body may differ
_CHOSEN_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_LEAST_REACH_MPS, _SPEED_REACH = 1.0, 0.3  # how far off a joining feature's velocity may be
_BETTER_THAN_REST = 9.0  # squared sigmas by which a body's motion must explain more than rest


@dataclass(frozen=True, slots=True)
class FeatureMotions:
    """N features now: ids, positions in world and their covariance (N, 3, 3), and the mean velocity
    (N, 3) since each was first remembered with its covariance (N, 3, 3); NaN where not known."""

    feature_id: IntArray
    p_world: FloatArray
    position_cov: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray

    @property
    def known(self) -> BoolArray:
        """Which features (N,) have a velocity."""
        return np.asarray(np.isfinite(self.velocity[:, 0]))


@dataclass(frozen=True, slots=True)
class FollowedBody:
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
            self._feature_id, nothing, np.empty((0, 3, 3)), nothing, np.empty((0, 3, 3))
        )

    def add(self, timestamp_ns: int, seen: ScenePoints, T_world_cam0: FloatArray) -> FeatureMotions:
        """Take a frame in, let those go that are too old, and say how its features moved."""
        recent = timestamp_ns - self._stamps <= 1e9 * _MEMORY_S
        order = np.argsort(self._feature_id)
        column = np.searchsorted(self._feature_id, seen.feature_id, sorter=order)
        column = order[np.minimum(column, len(order) - 1)] if len(order) else column
        new = np.ones(len(column), dtype=np.bool_)
        if len(order):
            new = self._feature_id[column] != seen.feature_id
        T, n = int(recent.sum()), len(column)
        p_world, covariance = np.full((T + 1, n, 3), np.nan), np.full((T + 1, n, 3, 3), np.nan)
        p_world[:T, ~new] = self._p_world[recent][:, column[~new]]
        covariance[:T, ~new] = self._covariance[recent][:, column[~new]]
        R = T_world_cam0[:3, :3]
        p_world[T] = se3.apply(T_world_cam0, seen.p_cam0)
        covariance[T] = R @ seen.cov_cam0 @ R.T
        self._stamps = np.append(self._stamps[recent], timestamp_ns)
        self._feature_id, self._p_world, self._covariance = seen.feature_id, p_world, covariance
        self.last = self._motions()
        return self.last

    def _motions(self) -> FeatureMotions:
        """From the oldest place that is remembered of each feature to the present one."""
        n = len(self._feature_id)
        age_s = 1e-9 * (self._stamps[-1] - self._stamps)
        then = np.isfinite(self._p_world[..., 0]) & (age_s > _SHORTEST_S)[:, None]
        oldest, some = np.argmax(then, axis=0), then.any(axis=0)
        dt = np.where(some, age_s[oldest], np.nan)
        columns = np.arange(n)
        moved = self._p_world[-1] - self._p_world[oldest, columns]
        spread = self._covariance[-1] + self._covariance[oldest, columns]
        return FeatureMotions(
            self._feature_id,
            self._p_world[-1],
            self._covariance[-1],
            moved / dt[:, None],
            spread / dt[:, None, None] ** 2,
        )


def follow(motions: FeatureMotions, own: BoolArray, velocity: FloatArray) -> FollowedBody | None:
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
    C = motions.velocity_cov[index] + _SPEED_SPREAD**2 * np.eye(3)
    off = motions.velocity[index] - velocity
    with_body = (off * np.linalg.solve(C + velocity_cov, off[..., None])[..., 0]).sum(-1)
    v = motions.velocity[index]
    at_rest = (v * np.linalg.solve(C, v[..., None])[..., 0]).sum(-1)
    # an unsure body would take up anything around it
    near_speed = np.linalg.norm(off, axis=1) < np.maximum(
        _LEAST_REACH_MPS, _SPEED_REACH * float(np.linalg.norm(velocity))
    )
    alike = (with_body < _CHOSEN_GATE) & near_speed
    joins[index] = alike & (at_rest > with_body + _BETTER_THAN_REST)
    return joins


def body_of(motions: FeatureMotions, own: BoolArray) -> FollowedBody:
    """The body that features (N,), known to move together, make up."""
    return _as_one(motions, np.flatnonzero(own), np.empty(0, dtype=np.int64))


def _as_one(motions: FeatureMotions, index: IntArray, strayed: IntArray) -> FollowedBody:
    W = np.linalg.inv(motions.velocity_cov[index])
    P_v = np.linalg.inv(W.sum(0))
    mean = P_v @ (W @ motions.velocity[index][..., None])[..., 0].sum(0)
    points = motions.p_world[index]
    P = np.zeros((6, 6))
    P[:3, :3] = motions.position_cov[index].mean(0) / len(index) + 0.01 * np.eye(3)
    P[3:, 3:] = P_v + 0.01 * np.eye(3)
    return FollowedBody(0.5 * (points.min(axis=0) + points.max(axis=0)), mean, P, strayed)


def _agreeing(velocity: FloatArray, C: FloatArray, before: FloatArray) -> BoolArray:
    """The largest set (N,) of features whose velocities are those of one of them."""
    apart = velocity[:, None] - velocity[None]
    spread = C[:, None] + C[None] + _SPEED_SPREAD**2 * np.eye(3)
    d = (apart * np.linalg.solve(spread, apart[..., None])[..., 0]).sum(-1)
    votes = d < _AGREE_SIGMAS**2
    best = votes.sum(1)
    # among equals the one that goes as the body did
    off = np.linalg.norm(velocity - before, axis=1)
    return np.asarray(votes[int(np.lexsort((off, -best))[0])])
