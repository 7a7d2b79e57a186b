"""Labels of points by their tracks: a point of a body moves as the body does.

A label is given where it is twice as likely as the other one; else the point is unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.feature_motions import CLEARLY, FeatureMotions, distances_from_rest_and_body
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_box import points_in_boxes
from ovmot.physics import WALKER_MPS, WALKER_SIGMA_MPS
from ovmot.types import PointLabel, ScenePoints

_PACE_MPS = WALKER_MPS - 1.28 * WALKER_SIGMA_MPS  # one walker in ten is slower
_LIKELIER = 0.43  # sigmas: a Gaussian has a third of its weight beyond
_LATE_S = 0.1  # a velocity is that of the middle of the time it was measured over
_STEADY = 0.5  # m/s²: noise of the change of a velocity


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds (T,) in m/s of tracks at one time, and their ids (T,), rising."""

    timestamp_ns: int
    track_id: IntArray
    speed: FloatArray


def label_points(
    now_ns: int,
    points: ScenePoints,
    track_id: IntArray,
    tracks: Sequence[Track],
    motions: FeatureMotions,
    before: Speeds,
) -> ScenePoints:
    """The N points with the ids of their tracks, `track_id` (N,), -1 for none.

    Points of a confirmed track are dynamic or static as the track is, but for those at rest in the
    box of one that moves. Points of a tentative track keep their label. A dynamic point without a
    track is unknown: it may be a wrong match. So is a static point without a track in the box of a
    moving one, if the track's motion fits it better. `before`: the speeds at the last frame.
    """
    label = points.label.copy()
    untracked = track_id < 0
    label[untracked & (label == int(PointLabel.DYNAMIC))] = int(PointLabel.UNKNOWN)
    confirmed = [t for t in tracks if t.state == TrackState.CONFIRMED]
    in_boxes = points_in_boxes(confirmed, motions.p_world, motions.position_cov)
    for track, in_box in zip(confirmed, in_boxes, strict=True):
        own = track_id == track.track_id
        track_label = _track_label(track, _speed_now(track, now_ns, before))
        label[own] = int(track_label)
        if track_label == PointLabel.DYNAMIC:
            label = _checked_for_rest(label, own, untracked & in_box, track, motions)
    return replace(points, track_id=track_id, label=label)


def speeds_of(now_ns: int, tracks: Sequence[Track]) -> Speeds:
    """The speeds of tracks."""
    ids = np.array([t.track_id for t in tracks], dtype=np.int64)
    speed = np.array([np.linalg.norm(t.velocity) for t in tracks], dtype=np.float64)
    order = np.argsort(ids)
    return Speeds(now_ns, ids[order], speed[order])


def _speed_now(track: Track, now_ns: int, before: Speeds) -> float:
    """A track's speed, extrapolated by its change since the last frame: the filter is late."""
    speed = float(np.linalg.norm(track.velocity))
    k = int(np.searchsorted(before.track_id, track.track_id))
    dt_s = 1e-9 * (now_ns - before.timestamp_ns)
    if k == len(before.track_id) or before.track_id[k] != track.track_id or dt_s <= 0.0:
        return speed
    change = (speed - float(before.speed[k])) / dt_s
    sure = max(change - _STEADY, 0.0) + min(change + _STEADY, 0.0)
    return max(speed + _LATE_S * sure, 0.0)


def _track_label(track: Track, speed: float) -> PointLabel:
    """The label of a track at its speed of now."""
    P = track.velocity_cov
    along = track.velocity / max(float(np.linalg.norm(track.velocity)), 1e-9)
    margin = _LIKELIER * float(np.sqrt(along @ P @ along))
    if speed + margin < _PACE_MPS:
        return PointLabel.STATIC
    return PointLabel.DYNAMIC if speed - margin > _PACE_MPS else PointLabel.UNKNOWN


def _checked_for_rest(
    label: IntArray, own: BoolArray, in_box: BoolArray, track: Track, motions: FeatureMotions
) -> IntArray:
    """Labels (N,), corrected for a moving track's `own` points (N,), and for points of no track in
    its box, `in_box` (N,), by their own motions."""
    P = track.velocity_cov
    from_rest, from_body, _ = distances_from_rest_and_body(motions, own | in_box, track.velocity, P)
    static = label == int(PointLabel.STATIC)
    unclear = np.where(own, from_rest < from_body, in_box & static & (from_rest > from_body))
    out = label.copy()
    out[unclear] = int(PointLabel.UNKNOWN)
    with np.errstate(invalid="ignore"):
        out[own & (from_rest + CLEARLY < from_body)] = int(PointLabel.STATIC)
    return out
