"""Motions of single features over the last tenths of a second, whatever body they are of.

A car that stops is not measured as a moving body, and one that was hidden comes back with few
features. The motion of each feature, against the predicted one of a track, tells which are its own.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.features_kernel import feature_motions_compiled, places_of_compiled
from ovmot.physics import ACCEL_SIGMA_MPS2, STEADY_S
from ovmot.types import ScenePoints

_NEVER = -(1 << 62)  # ns: older than any frame


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
        self._stamps = np.empty(0, dtype=np.int64)  # of the rows
        self._feature_id = self._place = np.empty(0, dtype=np.int64)  # of the last frame's features
        self._p_world = np.empty((0, 0, 3))
        self._covariance = np.empty((0, 0, 3, 3))

    def add(
        self, timestamp_ns: int, points: ScenePoints, T_world_cam0: FloatArray
    ) -> FeatureMotions:
        """Add a frame, in place of the oldest one, and return the motions of its features."""
        self._make_room(timestamp_ns, len(points.feature_id))
        place, is_new = places_of_compiled(
            points.feature_id, self._feature_id, self._place, len(self._p_world)
        )
        self._feature_id, self._place = points.feature_id, place
        now = int(self._stamps.argmin())
        self._stamps[now] = timestamp_ns
        found = feature_motions_compiled(
            points.p_cam0, points.cov_cam0, T_world_cam0, place, is_new,
            np.asarray(1e-9 * (timestamp_ns - self._stamps), np.float64), now, STEADY_S,
            ACCEL_SIGMA_MPS2,
            self._p_world, self._covariance,
        )  # fmt: skip
        return FeatureMotions(points.feature_id, *found)

    def _make_room(self, timestamp_ns: int, n_features: int) -> None:
        """Have a row to spare for a new frame, and a place for each of its features."""
        n_places, n_rows = self._p_world.shape[:2]
        more_places = 2 * max(n_features - n_places, 0)
        spare = self._stamps < timestamp_ns - round(1e9 * STEADY_S)
        more_rows = 0 if spare.any() else n_rows + 1
        if more_places or more_rows:
            room = ((0, more_places), (0, more_rows), (0, 0))
            self._p_world = np.pad(self._p_world, room, constant_values=np.nan)
            self._covariance = np.pad(self._covariance, (*room, (0, 0)))
            self._stamps = np.pad(self._stamps, (0, more_rows), constant_values=_NEVER)
