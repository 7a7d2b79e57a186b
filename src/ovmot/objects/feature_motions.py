"""Motions of single features over the last tenths of a second, whatever body they are of.

A car that stops is not measured as a moving body, and one that was hidden comes back with few
features. The motion of each feature, against the predicted one of a track, tells which are its own.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import positions
from ovmot.objects.features_kernel import feature_motions_compiled
from ovmot.physics import ACCEL_SIGMA_MPS2
from ovmot.types import ScenePoints

_MEMORY_S = 0.8


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
    """Positions of the present features over the last tenths of a second, in world.

    Each feature has its place in the memory, for as long as it is in view; frames take turns.
    """

    def __init__(self) -> None:
        none = np.empty(0, dtype=np.int64)
        self._stamps = none  # of the rows in use, oldest first
        self._rows = none
        self._place = none  # of the last frame's features
        self._p_world = np.full((0, 0, 3), np.nan)
        self._covariance = np.empty((0, 0, 3, 3))
        nothing = np.empty((0, 3))
        self.last = FeatureMotions(
            none, nothing, np.empty((0, 3, 3)), nothing, np.empty((0, 3, 3)), np.empty(0)
        )

    def add(
        self, timestamp_ns: int, points: ScenePoints, T_world_cam0: FloatArray
    ) -> FeatureMotions:
        """Add a frame, drop those that are too old, and return the motions of its features."""
        before = positions(points.feature_id, self.last.feature_id)
        is_new = before < 0
        self._make_room(timestamp_ns, len(before))
        place = np.full(len(before), -1, dtype=np.int64)
        place[~is_new] = self._place[before[~is_new]]
        free = np.ones(len(self._p_world), dtype=np.bool_)
        free[place[~is_new]] = False
        place[is_new] = np.flatnonzero(free)[: np.count_nonzero(is_new)]
        self._place = place
        age_s = np.asarray(1e-9 * (timestamp_ns - self._stamps), np.float64)
        found = feature_motions_compiled(
            points.p_cam0, points.cov_cam0, T_world_cam0, place, is_new, self._rows, age_s,
            ACCEL_SIGMA_MPS2, self._p_world, self._covariance,
        )  # fmt: skip
        self.last = FeatureMotions(points.feature_id, *found)
        return self.last

    def _make_room(self, timestamp_ns: int, n_features: int) -> None:
        """A row for a new frame, and a place for each of its features."""
        kept = self._stamps >= timestamp_ns - round(1e9 * _MEMORY_S)
        self._stamps, self._rows = self._stamps[kept], self._rows[kept]
        n_places, n_rows = self._p_world.shape[:2]
        more_places, more_rows = max(n_features - n_places, 0), int(len(self._rows) == n_rows)
        if more_places or more_rows:
            room = ((0, 2 * more_places), (0, n_rows + 1 if more_rows else 0), (0, 0))
            self._p_world = np.pad(self._p_world, room, constant_values=np.nan)
            self._covariance = np.pad(self._covariance, (*room, (0, 0)))
        free = np.ones(self._p_world.shape[1], dtype=np.bool_)
        free[self._rows] = False
        self._stamps = np.append(self._stamps, timestamp_ns)
        self._rows = np.append(self._rows, np.argmax(free))
