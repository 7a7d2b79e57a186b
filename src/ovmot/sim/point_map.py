"""A map of static points made along a path, with a quick search for those near a place."""

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray

_SLACK_M = 2.0
"""The list of near points is made anew after this much motion."""


class PointMap:
    """A map that only grows. A point's index is its place in the order of making."""

    def __init__(self, radius_m: float) -> None:
        self._radius = radius_m
        self._batches: list[FloatArray] = []
        self._first_index = [0]
        self._balls = np.empty((0, 4))  # of each batch: a centre, and how far its points lie off
        self._center = np.full(3, np.inf)
        self._near_index = np.empty(0, dtype=np.int64)
        self._near_points = np.empty((0, 3))

    def near(self, center: FloatArray) -> tuple[IntArray, FloatArray]:
        """Rising indices (N,) and positions (N, 3) of all points within the radius of a place (3,),
        and of some beyond it."""
        if not np.linalg.norm(center - self._center) < _SLACK_M:
            self._center = center.copy()
            self._collect(self._radius + _SLACK_M)
        return self._near_index, self._near_points

    def add(self, points: FloatArray) -> None:
        """Takes in new points (N, 3), made around the place that `near` was last asked for."""
        center = self._center
        far = float(np.max(np.linalg.norm(points - center, axis=1), initial=0.0))
        first = self._first_index[-1]
        self._batches.append(points)
        self._first_index.append(first + len(points))
        self._balls = np.concatenate([self._balls, [[*center, far]]])
        index = first + np.arange(len(points))
        self._near_index = np.concatenate([self._near_index, index])
        self._near_points = np.concatenate([self._near_points, points])

    def _collect(self, radius: float) -> None:
        """Lists the points within a radius of the present place."""
        apart = np.linalg.norm(self._balls[:, :3] - self._center, axis=1)
        touching = np.flatnonzero(apart < radius + self._balls[:, 3])
        none = np.empty((0, 3))
        points = np.concatenate([none, *(self._batches[k] for k in touching)])
        ranges = (np.arange(self._first_index[k], self._first_index[k + 1]) for k in touching)
        index = np.concatenate([np.empty(0, dtype=np.int64), *ranges])
        near = np.linalg.norm(points - self._center, axis=1) < radius
        self._near_index, self._near_points = index[near], points[near]
