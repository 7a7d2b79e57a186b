"""One track: its filter, its features and its life."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ovmot.config import ObjectTrackSettings
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.motion_models import VELOCITY, Agility
from ovmot.objects.object_filter import (
    BodyFilter,
    Observation,
    distance,
    observe,
    predict,
    start_filter,
    update,
)

_SLIDE = 0.25  # of the size: how far the middle of what is seen lies off the body's middle
_LEAST_SLIDE_M = 0.2
_VEHICLE_M = 4.5  # length
DRIVES_MPS = 3.0
"""Faster than who walks."""
_MOVING_MPS = 0.5  # slower, the velocity has no direction
_MANY_FEATURES = 5  # that move together are no chance: two measurements are enough
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

    `center` (3,): middle of the points seen last; `offset` (3,) from the filter's position to it.
    `feature_id`, `p_world`: its features and where they were (n, 3) at `features_ns`. `hits` counts
    measurements; `measured_ns`, `updated_ns`: when the last one came, when anything was seen of it.
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
    the number of measurements that fall into the span.
    """
    R = measurement.covariance.copy()
    slide = np.maximum(_SLIDE * float(np.max(size)), _LEAST_SLIDE_M)
    R[:3, :3] += slide**2 * np.eye(3)
    again = 1.0 if dt_s is None else max(measurement.span_s / max(dt_s, 1e-3), 1.0)
    R *= again
    return observe(
        measurement.position, measurement.velocity, R, measurement.yaw_rate,
        again * measurement.yaw_rate_variance,
    )  # fmt: skip


def start_track(track_id: int, now_ns: int, measurement: ObjectMeasurement) -> Track:
    """A tentative track from a measurement that belongs to no other."""
    size = measurement.size
    return Track(
        track_id=track_id,
        state=TrackState.TENTATIVE,
        filter=start_filter(now_ns, as_observation(measurement, size, None)),
        offset=np.zeros(3),
        size=np.minimum(size, _BIGGEST),
        yaw=float(np.arctan2(measurement.velocity[1], measurement.velocity[0])),
        feature_id=measurement.feature_id,
        born_ns=now_ns,
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=1,
        evidence=0.0,
    )


def carried(track: Track, now_ns: int, settings: ObjectTrackSettings) -> Track:
    """The track predicted to a time."""
    return replace(track, filter=predict(track.filter, now_ns, agility(settings)))


def gap(track: Track, measurement: ObjectMeasurement, now_ns: int) -> float:
    """Squared distance (6 degrees of freedom) between a predicted track and a measurement.

    What drives is longer than what may have been seen of it: after an occlusion its other end may
    come into view.
    """
    dt = 1e-9 * (now_ns - track.measured_ns)
    size = np.maximum(track.size, measurement.size)
    observation = as_observation(measurement, size, dt)
    speed = float(np.hypot(track.velocity[0], track.velocity[1]))
    if speed > DRIVES_MPS:
        heading = track.velocity / speed
        hidden = np.maximum(_VEHICLE_M - float(size[0]), 0.0) * _SLIDE
        observation.covariance[:3, :3] += hidden**2 * np.outer(heading, heading)
    six = Observation(observation.H[:6], observation.value[:6], observation.covariance[:6, :6])
    return distance(track.filter, six)


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
        yaw=float(np.arctan2(velocity[1], velocity[0])) if fast else track.yaw,
        feature_id=np.union1d(measurement.feature_id, track.feature_id),
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=hits,
        evidence=evidence,
    )
