"""What the tracks say of the points: one that belongs to a body does what the body does.

Between a body that moves and one that stands there are those that creep. A label is given where it
is twice as likely as the other one; else the point stays unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.feature_motions import FeatureMotions, rest_or_body
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.region import inside
from ovmot.objects.track import Track, TrackState
from ovmot.types import PointLabel, ScenePoints

_MOVING_MPS = 1.0  # the pace of a slow walker
_LIKELIER = 0.43  # sigmas: a Gaussian has a third of its weight beyond
_LATE_S = 0.1  # a velocity is that of the middle of the time it was measured over
_STEADY = 0.5  # m/s²: by which a velocity seems to change without
_CLEAR = 9.0  # squared sigmas by which rest must explain a point of a moving body better


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds (T,) in m/s of tracks at one time, and their ids (T,), rising."""

    timestamp_ns: int
    track_id: IntArray
    speed: FloatArray


def label_points(
    now_ns: int,
    seen: ScenePoints,
    owner: IntArray,
    tracks: Sequence[Track],
    motions: FeatureMotions,
    before: Speeds,
) -> ScenePoints:
    """The N points with the ids of their tracks, `owner` (N,), -1 for none.

    Those of a confirmed track are dynamic or static as the track is, but for points which rest
    beside one that moves. Those of a tentative track stay as the split found them. What seems to
    move and is part of no body is unknown: a wrong match looks like that. So is a point that seems
    to rest where a body moves, if that body's motion explains it better. `before`: the speeds at
    the last frame.
    """
    label = seen.label.copy()
    loose = owner < 0
    label[loose & (label == int(PointLabel.DYNAMIC))] = int(PointLabel.UNKNOWN)
    confirmed = [t for t in tracks if t.state == TrackState.CONFIRMED]
    near = inside(confirmed, motions.p_world, motions.position_cov)
    for track, at in zip(confirmed, near, strict=True):
        own = owner == track.track_id
        kind = _kind(track, _speed_now(track, now_ns, before))
        label[own] = int(kind)
        if kind == PointLabel.DYNAMIC:
            label = _doubted(label, own, loose & at, track, motions)
    return replace(seen, track_id=owner, label=label)


def speeds_of(now_ns: int, tracks: Sequence[Track]) -> Speeds:
    """How fast tracks are."""
    ids = np.array([t.track_id for t in tracks], dtype=np.int64)
    speed = np.array([np.linalg.norm(t.velocity) for t in tracks], dtype=np.float64)
    order = np.argsort(ids)
    return Speeds(now_ns, ids[order], speed[order])


def _speed_now(track: Track, now_ns: int, before: Speeds) -> float:
    """A track's speed, carried on to now by its change since the last frame: the filter is late."""
    speed = float(np.linalg.norm(track.velocity))
    k = int(np.searchsorted(before.track_id, track.track_id))
    dt_s = 1e-9 * (now_ns - before.timestamp_ns)
    if k == len(before.track_id) or before.track_id[k] != track.track_id or dt_s <= 0.0:
        return speed
    change = (speed - float(before.speed[k])) / dt_s
    sure = max(change - _STEADY, 0.0) + min(change + _STEADY, 0.0)
    return max(speed + _LATE_S * sure, 0.0)


def _kind(track: Track, speed: float) -> PointLabel:
    """What a track does, at its speed of now."""
    P = track.filter.best.covariance[VELOCITY, VELOCITY]
    along = track.velocity / max(float(np.linalg.norm(track.velocity)), 1e-9)
    margin = _LIKELIER * float(np.sqrt(along @ P @ along))
    if speed + margin < _MOVING_MPS:
        return PointLabel.STATIC
    return PointLabel.DYNAMIC if speed - margin > _MOVING_MPS else PointLabel.UNKNOWN


def _doubted(
    label: IntArray, own: BoolArray, beside: BoolArray, track: Track, motions: FeatureMotions
) -> IntArray:
    """Labels (N,), those of a moving track's own points and of those beside it by their motions."""
    index = np.flatnonzero(own | beside)
    P = track.filter.best.covariance[VELOCITY, VELOCITY]
    at_rest, with_body = rest_or_body(motions, index, track.velocity, P)
    mine, seems_static = own[index], label[index] == int(PointLabel.STATIC)
    unclear = np.where(mine, at_rest < with_body, seems_static & (at_rest > with_body))
    out = label.copy()
    out[index[unclear]] = int(PointLabel.UNKNOWN)
    out[index[mine & (at_rest + _CLEAR < with_body)]] = int(PointLabel.STATIC)
    return out
