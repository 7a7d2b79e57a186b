"""One track: its filter, its features and its life."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import union
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.motion_models import N_STATE, VELOCITY, Agility
from ovmot.objects.object_filter import (
    BodyFilter,
    Observation,
    observe,
    predict,
    start_filter,
    update,
)
from ovmot.settings import ObjectTrackSettings

_DRIFT = 0.25  # of the size: how far the middle of what is seen lies off the body's middle
_LEAST_DRIFT_M = 0.2
_VEHICLE_M = 4.5  # length
DRIVES_MPS = 3.0
"""Faster than who walks."""
_MOVING_MPS = 0.5  # slower, the velocity has no direction
_MANY_FEATURES = 5  # that move together are no chance: two measurements are enough
_SURELY_MOVES = 40.0  # squared sigmas from rest: less than 1e-8 by chance, as two measurements
_ACROSS = 0.5  # of the velocity along the ray, that one across it must be at least
_ROAD_USER = Observation(  # what is known of a velocity before it is measured
    np.eye(3, N_STATE, VELOCITY.start), np.zeros(3), np.diag([10.0, 10.0, 0.5]) ** 2
)
_GROWTH = 0.5  # share of the way to a greater size that a measurement makes
_SHRINK = 0.97  # of the size, where a measurement shows less
_BIGGEST = np.array([20.0, 4.0, 5.0])


class TrackState(StrEnum):
    """How sure a track is of its body."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


@dataclass(frozen=True, slots=True)
class Track:
    """A body that was seen to move.

    `offset` (3,): from the filter's position to the middle of the points seen last. `feature_id`
    (n,): its features, rising. `hits` counts measurements; `measured_ns`, `updated_ns`: when the
    last one came, when anything was seen of it.
    """

    track_id: int
    state: TrackState
    filter: BodyFilter
    offset: FloatArray
    size: FloatArray
    yaw: float
    feature_id: IntArray
    born_ns: int
    measured_ns: int
    updated_ns: int
    hits: int
    evidence: float
    overlaps: int = 0

    @property
    def position(self) -> FloatArray:
        """Middle of what was seen of it, carried on."""
        position: FloatArray = self.filter.best.state[:3] + self.offset
        return position

    @property
    def velocity(self) -> FloatArray:
        velocity: FloatArray = self.filter.best.state[VELOCITY]
        return velocity


def agility(settings: ObjectTrackSettings) -> Agility:
    """The process noise that the settings tell."""
    return Agility(settings.accel, settings.lift, settings.yaw_accel)


def as_observation(
    measurement: ObjectMeasurement, size: FloatArray, dt_s: float | None
) -> Observation:
    """A measurement for the filter.

    The middle of the seen points may lie anywhere on the body. Motions over a span longer than the
    time since the last measurement, `dt_s`, share most of what they saw: their variance grows by
    the number of measurements that fall into the span. Whether a body moves was asked with all the
    noise that was told; how fast, only with what the points show of it.
    """
    R = measurement.covariance - measurement.excess
    R[:3, :3] += _drift(size) ** 2 * np.eye(3)
    again = 1.0
    if dt_s is not None:
        again = float(_repeats(np.array(measurement.span_s), np.array(dt_s)))
    R *= again
    return observe(
        measurement.position, measurement.velocity, R, measurement.yaw_rate,
        again * measurement.yaw_rate_variance,
    )  # fmt: skip


def start_track(track_id: int, now_ns: int, measurement: ObjectMeasurement) -> Track:
    """A track from a measurement that belongs to no other.

    Where the measurement tells little of the velocity, along the ray from far, the velocities that
    road users have tell more.
    """
    size = measurement.size
    body = update(start_filter(now_ns, as_observation(measurement, size, None)), _ROAD_USER)
    return Track(
        track_id=track_id,
        state=TrackState.CONFIRMED if is_sure(measurement) else TrackState.TENTATIVE,
        filter=body,
        offset=np.zeros(3),
        size=np.minimum(size, _BIGGEST),
        yaw=_heading(body.best.state[VELOCITY]),
        feature_id=np.sort(measurement.feature_id),
        born_ns=now_ns,
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=1,
        evidence=0.0,
    )


def _heading(velocity: FloatArray) -> float:
    return float(np.arctan2(velocity[1], velocity[0]))


def is_sure(measurement: ObjectMeasurement) -> bool:
    """Do many features move together, across that direction in which they are known worst?

    That is the ray's: along it, patches may slide together.
    """
    variance, axes = np.linalg.eigh(measurement.covariance[3:, 3:])
    squared = (axes.T @ measurement.velocity) ** 2
    from_rest = float((squared[:2] / variance[:2]).sum())
    across = float(squared[:2].sum()) > _ACROSS**2 * float(squared[2])
    return len(measurement.feature_id) >= _MANY_FEATURES and from_rest > _SURELY_MOVES and across


def carried(track: Track, now_ns: int, settings: ObjectTrackSettings) -> Track:
    """The track predicted to a time."""
    return replace(track, filter=predict(track.filter, now_ns, agility(settings)))


def gaps(
    tracks: Sequence[Track], measurements: Sequence[ObjectMeasurement], now_ns: int
) -> FloatArray:
    """Squared distances (T, M), 6 degrees of freedom, of predicted tracks and measurements.

    What drives is longer than what may have been seen of it: after an occlusion its other end may
    come into view.
    """
    best = [track.filter.best for track in tracks]
    state = np.array([e.state[:6] for e in best])
    P = np.array([e.covariance[:6, :6] for e in best])
    value = np.array([np.concatenate([m.position, m.velocity]) for m in measurements])
    R = np.array([m.covariance for m in measurements])
    size = np.maximum(
        np.array([t.size for t in tracks])[:, None], np.array([m.size for m in measurements])
    )
    since = np.array([1e-9 * (now_ns - t.measured_ns) for t in tracks])
    again = _repeats(np.array([m.span_s for m in measurements]), since[:, None])
    spread = np.zeros((len(tracks), len(measurements), 6, 6))
    spread[..., :3, :3] = (_drift(size) ** 2)[..., None, None] * np.eye(3)
    S = P[:, None] + (R + spread) * again[..., None, None]
    v = state[:, 3:]
    speed = np.hypot(v[:, 0], v[:, 1])
    heading = np.where(speed > DRIVES_MPS, 1.0, 0.0)[:, None] * v / np.maximum(speed, 1e-9)[:, None]
    hidden = np.maximum(_VEHICLE_M - size[..., 0], 0.0) * _DRIFT
    S[..., :3, :3] += (hidden**2)[..., None, None] * (heading[:, :, None] * heading[:, None])[
        :, None
    ]
    r = value - state[:, None]
    distance: FloatArray = (r * np.linalg.solve(S, r[..., None])[..., 0]).sum(-1)
    return distance


def _drift(size: FloatArray) -> FloatArray:
    """How far (...,) the middle of what is seen may lie off that of bodies of a size (..., 3)."""
    return np.asarray(np.maximum(_DRIFT * size.max(-1), _LEAST_DRIFT_M))


def _repeats(span_s: FloatArray, since_s: FloatArray) -> FloatArray:
    """How many measurements share what was seen over a span, when one comes every `since_s`."""
    return np.maximum(span_s / np.maximum(since_s, 1e-3), 1.0)


def measured(
    track: Track, measurement: ObjectMeasurement, now_ns: int, settings: ObjectTrackSettings
) -> Track:
    """The track corrected by its measurement."""
    dt = 1e-9 * (now_ns - track.measured_ns)
    size = np.maximum(_SHRINK * track.size, track.size + _GROWTH * (measurement.size - track.size))
    body = update(track.filter, as_observation(measurement, size, dt))
    hits = track.hits + 1
    evidence = track.evidence + min(dt, settings.confirm_s)
    sure = hits >= settings.confirm_hits and evidence >= settings.confirm_s
    sure |= hits > 1 and len(measurement.feature_id) >= _MANY_FEATURES
    known = track.state != TrackState.TENTATIVE or sure
    velocity = body.best.state[VELOCITY]
    fast = np.hypot(velocity[0], velocity[1]) > _MOVING_MPS
    return replace(
        track,
        state=TrackState.CONFIRMED if known else TrackState.TENTATIVE,
        filter=body,
        offset=measurement.position - body.best.state[:3],
        size=np.minimum(size, _BIGGEST),
        yaw=_heading(velocity) if fast else track.yaw,
        feature_id=union(track.feature_id, measurement.feature_id),
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=hits,
        evidence=evidence,
    )


def place_variance(track: Track) -> float:
    """Of its position over ground, in either direction, m²."""
    return 0.5 * float(np.trace(track.filter.best.covariance[:2, :2]))
