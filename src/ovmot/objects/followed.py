"""Bodies that are still seen though nothing was measured: their features tell where they are.

A car that stops has no motion to be found by. Its features are still followed: each one's position
now, against where it was some tenths of a second ago, says how the body has moved.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.types import ScenePoints

_MIN_FEATURES = 3
_MOST_FEATURES = 24  # of one body: more tell little more
_AGREE_SIGMAS = 3.0
_MEMORY_S = 0.8


@dataclass(frozen=True, slots=True)
class Sighting:
    """Where the features of a frame were in the world, with their covariance (N, 3, 3)."""

    timestamp_ns: int
    feature_id: IntArray
    p_world: FloatArray
    covariance: FloatArray


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
    """The last frames' features in the world."""

    def __init__(self) -> None:
        self._frames: deque[Sighting] = deque()

    def add(self, timestamp_ns: int, seen: ScenePoints, T_world_cam0: FloatArray) -> None:
        """Take a frame in, and let those go that are too old."""
        known = np.isfinite(seen.p_cam0).all(axis=1)
        R = T_world_cam0[:3, :3]
        order = np.argsort(seen.feature_id[known])
        self._frames.append(
            Sighting(
                timestamp_ns,
                seen.feature_id[known][order],
                se3.apply(T_world_cam0, seen.p_cam0[known])[order],
                (R @ seen.cov_cam0[known] @ R.T)[order],
            )
        )
        while timestamp_ns - self._frames[0].timestamp_ns > 1e9 * _MEMORY_S:
            self._frames.popleft()

    def follow(self, feature_id: IntArray, velocity: FloatArray) -> FollowedBody | None:
        """What these features say of their body, whose velocity (3,) was about so before.

        None where fewer than three of them were seen then and now and moved alike.
        """
        now = self._frames[-1]
        for then in self._frames:
            if now.timestamp_ns - then.timestamp_ns < 5e7:
                break
            body = _moved(then, now, feature_id, velocity)
            if body is not None:
                return body
        return None


def _moved(
    then: Sighting, now: Sighting, feature_id: IntArray, velocity: FloatArray
) -> FollowedBody | None:
    dt = 1e-9 * (now.timestamp_ns - then.timestamp_ns)
    both = np.intersect1d(np.intersect1d(then.feature_id, now.feature_id), feature_id)
    if len(both) < _MIN_FEATURES:
        return None
    both = both[:: -(-len(both) // _MOST_FEATURES)]
    a = np.searchsorted(then.feature_id, both)
    b = np.searchsorted(now.feature_id, both)
    moved = (now.p_world[b] - then.p_world[a]) / dt
    C = (now.covariance[b] + then.covariance[a]) / dt**2
    alike = _agreeing(moved, C, velocity)
    if alike.sum() < _MIN_FEATURES:
        return None
    W = np.linalg.inv(C[alike])
    P_v = np.linalg.inv(W.sum(0))
    mean = P_v @ (W @ moved[alike][..., None])[..., 0].sum(0)
    points = now.p_world[b][alike]
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    P = np.zeros((6, 6))
    P[:3, :3] = now.covariance[b][alike].mean(0) / alike.sum() + 0.01 * np.eye(3)
    P[3:, 3:] = P_v + 0.01 * np.eye(3)
    return FollowedBody(middle, mean, P, both[~alike])


def _agreeing(moved: FloatArray, C: FloatArray, velocity: FloatArray) -> BoolArray:
    """The largest set (N,) of features whose velocities are those of one of them."""
    apart = moved[:, None] - moved[None]
    spread = C[:, None] + C[None] + 0.04 * np.eye(3)
    d = (apart * np.linalg.solve(spread, apart[..., None])[..., 0]).sum(-1)
    votes = d < _AGREE_SIGMAS**2
    best = votes.sum(1)
    # among equals the one that goes as the body did
    off = np.linalg.norm(moved - velocity, axis=1)
    return np.asarray(votes[int(np.lexsort((off, -best))[0])])
