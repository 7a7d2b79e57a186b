"""Labels of points by their tracks: a point of a body moves as the body does.

A label is given where it is twice as likely as the other one; else the point is unknown.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_features import LIMITS, ids_of, moving_of
from ovmot.objects.track_features_kernel import Hulls, labelled_compiled
from ovmot.physics import WALKER_MPS, WALKER_SIGMA_MPS, sigmas
from ovmot.types import PointLabel, ScenePoints

_PACE_MPS = WALKER_MPS - sigmas(0.9) * WALKER_SIGMA_MPS  # one walker in ten is slower
_LIKELIER = sigmas(2 / 3)
_NO_LABEL = -1


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds (T,) in m/s of tracks at one time, and their ids (T,), rising."""

    track_id: IntArray
    speed: FloatArray


def label_points(
    points: ScenePoints,
    owner: IntArray,
    tracks: Sequence[Track],
    hulls: Hulls,
    motions: FeatureMotions,
    before: Speeds,
) -> ScenePoints:
    """The N points with the ids of their tracks, of rows `owner` (N,), -1 for none.

    Points of a confirmed track are dynamic or static as the track is, but for those at rest in the
    box of one that moves. Points of a tentative track keep their label. A dynamic point without a
    track is unknown: it may be a wrong match. So is a static point without a track in the box of a
    moving one, if the track's motion fits it better. `before`: the speeds at the last frame.
    """
    names = (int(PointLabel.STATIC), int(PointLabel.DYNAMIC), int(PointLabel.UNKNOWN))
    of_track = [_track_label(t, _next_speed(t, before)) for t in tracks]
    label = labelled_compiled(
        points.label, owner, np.array(of_track, np.int64), hulls, moving_of(motions),
        names, LIMITS,
    )  # fmt: skip
    return replace(points, track_id=ids_of(tracks)[owner], label=label)


def speeds_of(tracks: Sequence[Track]) -> Speeds:
    """The speeds of tracks."""
    ids = np.array([t.track_id for t in tracks], dtype=np.int64)
    speed = np.array([np.linalg.norm(t.velocity) for t in tracks], dtype=np.float64)
    order = np.argsort(ids)
    return Speeds(ids[order], speed[order])


def _next_speed(track: Track, before: Speeds) -> float:
    """A track's speed in the next frame, for which labels are, by its change since the last one."""
    speed = float(np.linalg.norm(track.velocity))
    k = int(np.searchsorted(before.track_id, track.track_id))
    if k == len(before.track_id) or before.track_id[k] != track.track_id:
        return speed
    return max(2.0 * speed - float(before.speed[k]), 0.0)


def _track_label(track: Track, speed: float) -> int:
    """The label of the features of a track at its speed of now; -1 where it gives none."""
    if track.state != TrackState.CONFIRMED:
        return _NO_LABEL
    v, P = track.velocity, track.velocity_cov
    margin = _LIKELIER * math.sqrt(float(v @ P @ v)) / max(math.hypot(*v), 1e-9)
    if speed + margin < _PACE_MPS:
        return int(PointLabel.STATIC)
    return int(PointLabel.DYNAMIC if speed - margin > _PACE_MPS else PointLabel.UNKNOWN)
