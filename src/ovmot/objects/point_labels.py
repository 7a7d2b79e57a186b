"""Labels of points by their tracks: a point of a body moves as the body does.

Whether a body moves is decided by the likelihood of its velocity in motion against that at rest. A
label is given where the evidence is substantial (odds of √10; H. Jeffreys, "Theory of
probability", app. B); else the point is unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.feature_motions import CLEARLY, FeatureMotions, distances_from_rest_and_body
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_box import points_in_boxes
from ovmot.physics import ACCEL_SIGMA_MPS2, ROAD_SPEED_SIGMA_MPS
from ovmot.types import PointLabel, ScenePoints

_ODDS = 10.0**0.5
_LAG_S = 0.1  # a measured velocity is that of the middle of its span
_CHANGE_SIGMA_MPS2 = 0.5  # noise of the change of a speed


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
    rest_speed_mps: float,
) -> ScenePoints:
    """The N points with the ids of their tracks, `track_id` (N,), -1 for none.

    Points of a confirmed track are dynamic or static as the track is, but for those at rest in the
    box of one that moves. Points of a tentative track keep their label. A dynamic point without a
    track is unknown: it may be a wrong match. So is a static point without a track in the box of a
    moving one, if the track's motion fits it better. `before`: the speeds at the last frame;
    `rest_speed_mps`: standard deviation of the drift of points at rest, m/s.
    """
    label = points.label.copy()
    untracked = track_id < 0
    label[untracked & (label == int(PointLabel.DYNAMIC))] = int(PointLabel.UNKNOWN)
    confirmed = [t for t in tracks if t.state == TrackState.CONFIRMED]
    in_boxes = points_in_boxes(confirmed, motions.p_world, motions.position_cov)
    velocity = np.array([_velocity_now(t, now_ns, before) for t in confirmed]).reshape(-1, 3)
    P = np.array([t.filter.best.covariance[VELOCITY, VELOCITY] for t in confirmed])
    of_track = velocity_labels(velocity, P.reshape(-1, 3, 3), rest_speed_mps)
    for track, track_label, in_box in zip(confirmed, of_track.tolist(), in_boxes, strict=True):
        own = track_id == track.track_id
        label[own] = track_label
        if track_label == int(PointLabel.DYNAMIC):
            label = _checked_for_rest(label, own, untracked & in_box, track, motions)
    return replace(points, track_id=track_id, label=label)


def speeds_of(now_ns: int, tracks: Sequence[Track]) -> Speeds:
    """The speeds of tracks."""
    ids = np.array([t.track_id for t in tracks], dtype=np.int64)
    speed = np.array([np.linalg.norm(t.velocity) for t in tracks], dtype=np.float64)
    order = np.argsort(ids)
    return Speeds(now_ns, ids[order], speed[order])


def _velocity_now(track: Track, now_ns: int, before: Speeds) -> FloatArray:
    """A track's velocity (3,), its speed extrapolated over the lag by its change since the last
    frame."""
    speed = float(np.linalg.norm(track.velocity))
    k = int(np.searchsorted(before.track_id, track.track_id))
    dt_s = 1e-9 * (now_ns - before.timestamp_ns)
    if k == len(before.track_id) or before.track_id[k] != track.track_id or dt_s <= 0.0:
        return track.velocity
    change = (speed - float(before.speed[k])) / dt_s
    sure = max(change - _CHANGE_SIGMA_MPS2, 0.0) + min(change + _CHANGE_SIGMA_MPS2, 0.0)
    now = max(speed + _LAG_S * sure, 0.0)
    return track.velocity * (now / max(speed, 1e-9))


def velocity_labels(
    velocity: FloatArray, covariance: FloatArray, rest_speed_mps: float
) -> IntArray:
    """Labels (T,) of bodies by their velocities (T, 3) in m/s, world, with covariances P (T, 3, 3).

    At rest v ~ N(0, P + s² I) with the drift s of points at rest; in motion v ~ N(0, P + Σ) with
    the velocities Σ of road users. P grows by a road user's acceleration over the filter's lag.
    """
    P = covariance + (ACCEL_SIGMA_MPS2 * _LAG_S) ** 2 * np.eye(3)
    at_rest = _log_likelihood(velocity, P + rest_speed_mps**2 * np.eye(3))
    in_motion = _log_likelihood(velocity, P + np.diag(ROAD_SPEED_SIGMA_MPS) ** 2)
    evidence = in_motion - at_rest
    label = np.where(evidence > 0.0, int(PointLabel.DYNAMIC), int(PointLabel.STATIC))
    label[np.abs(evidence) < np.log(_ODDS)] = int(PointLabel.UNKNOWN)
    return label


def _log_likelihood(v: FloatArray, C: FloatArray) -> FloatArray:
    """Of v (T, 3) under N(0, C), C (T, 3, 3), but for a constant."""
    return np.asarray(-0.5 * (squared_distance(v, C) + np.log(np.linalg.det(C))))


def _checked_for_rest(
    label: IntArray, own: BoolArray, in_box: BoolArray, track: Track, motions: FeatureMotions
) -> IntArray:
    """Labels (N,), corrected for a moving track's `own` points (N,), and for points of no track in
    its box, `in_box` (N,), by their own motions."""
    index = np.flatnonzero(own | in_box)
    P = track.filter.best.covariance[VELOCITY, VELOCITY]
    from_rest, from_body = distances_from_rest_and_body(motions, index, track.velocity, P)
    of_track, static = own[index], label[index] == int(PointLabel.STATIC)
    unclear = np.where(of_track, from_rest < from_body, static & (from_rest > from_body))
    out = label.copy()
    out[index[unclear]] = int(PointLabel.UNKNOWN)
    out[index[of_track & (from_rest + CLEARLY < from_body)]] = int(PointLabel.STATIC)
    return out
