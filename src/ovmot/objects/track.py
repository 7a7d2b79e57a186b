"""One track of a body: its filter, its features, and how it is started, predicted and updated."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import union
from ovmot.objects.filter_kernel import N_STATE
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.motion_models import ROAD_USER_AGILITY, VELOCITY
from ovmot.objects.object_filter import (
    BodyFilter,
    Observation,
    observe,
    predict,
    start_filter,
    update,
)
from ovmot.physics import MAX_VEHICLE_SIZE_M, ROAD_SPEED_SIGMA_MPS, gate
from ovmot.settings import ObjectTrackSettings

CENTRE_SHARE = 0.25
"""Of the size: standard deviation of the centre of the seen points from that of the body."""
_LEAST_CENTRE_SIGMA_M = 0.2
DRIVES_MPS = 3.0
"""Faster than who walks."""
_MOVING_MPS = 0.5  # slower, the velocity has no direction
_MANY_FEATURES = 5  # with one velocity are not by chance: two measurements are enough
ACROSS_SHARE = 0.5
"""Of the velocity along the ray, that one across it must be at least."""
_GROWTH = 0.5  # gain towards a greater size
_SHRINK = 0.97  # of the size, where a measurement shows less


class TrackState(StrEnum):
    """How sure a track is of its body."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


@dataclass(frozen=True, slots=True)
class Track:
    """A body that was seen to move; world axes, SI.

    `offset` (3,): from the filter's position to the centre of the points seen last. `feature_id`
    (n,): its features, rising. `hits` counts measurements, `evidence` the seconds that they span;
    `measured_ns`: time of the last measurement, `updated_ns`: of the last update of any kind.
    `overlaps`: frames in a row in which it was a duplicate of an older track.
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
        """Predicted centre (3,) of the points that were seen last, in world."""
        position: FloatArray = self.filter.best.state[:3] + self.offset
        return position

    @property
    def velocity(self) -> FloatArray:
        """Velocity (3,) in world, m/s."""
        velocity: FloatArray = self.filter.best.state[VELOCITY]
        return velocity


def as_observation(
    measurement: ObjectMeasurement, size: FloatArray, dt_s: float | None
) -> Observation:
    """A measurement for the filter.

    The centre of the seen points may lie anywhere on the body. Measurements over a span longer than
    the time since the last one, `dt_s`, are correlated: their variance grows by their number in the
    span. Whether a body moves was tested with the prior noise; its velocity enters with the noise
    scaled by the variance factor.
    """
    R = measurement.scaled_covariance.copy()
    R[:3, :3] += centre_sigma(size) ** 2 * np.eye(3)
    correlated = 1.0
    if dt_s is not None:
        correlated = float(correlated_count(np.array(measurement.span_s), np.array(dt_s)))
    R *= correlated
    return observe(
        measurement.position, measurement.velocity, R, measurement.yaw_rate,
        correlated * measurement.yaw_rate_variance,
    )  # fmt: skip


def start_track(track_id: int, now_ns: int, measurement: ObjectMeasurement) -> Track:
    """A track from a measurement that is associated with no other one.

    Its velocity has the prior of road users' velocities, which matters along the ray of far bodies.
    """
    size = measurement.size
    prior = Observation(
        np.eye(3, N_STATE, VELOCITY.start), np.zeros(3), np.diag(ROAD_SPEED_SIGMA_MPS) ** 2
    )
    body = update(start_filter(now_ns, as_observation(measurement, size, None)), prior)
    return Track(
        track_id=track_id,
        state=TrackState.CONFIRMED if is_conclusive(measurement) else TrackState.TENTATIVE,
        filter=body,
        offset=np.zeros(3),
        size=np.minimum(size, MAX_VEHICLE_SIZE_M),
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


def is_conclusive(measurement: ObjectMeasurement) -> bool:
    """Do many features move together, across the direction in which their velocity is known worst?

    That is the ray's: along it, patches may drift together.
    """
    variance, axes = np.linalg.eigh(measurement.covariance[3:, 3:])
    squared = (axes.T @ measurement.velocity) ** 2
    from_rest = float((squared[:2] / variance[:2]).sum())
    across = float(squared[:2].sum()) > ACROSS_SHARE**2 * float(squared[2])
    moves = from_rest > gate(2, 1.0 - 1e-8)  # as two measurements of a false alarm of 1e-4 each
    return len(measurement.feature_id) >= _MANY_FEATURES and moves and across


def predict_track(track: Track, now_ns: int) -> Track:
    """The track predicted to a time."""
    return replace(track, filter=predict(track.filter, now_ns, ROAD_USER_AGILITY))


def centre_sigma(size: FloatArray) -> FloatArray:
    """Standard deviation (...,) of the centre of the seen points from that of bodies of a size
    (..., 3), metres."""
    return np.asarray(np.maximum(CENTRE_SHARE * size.max(-1), _LEAST_CENTRE_SIGMA_M))


def correlated_count(span_s: FloatArray, since_s: FloatArray) -> FloatArray:
    """How many measurements fall into one's span, when one comes every `since_s`."""
    return np.maximum(span_s / np.maximum(since_s, 1e-3), 1.0)


def update_track(
    track: Track, measurement: ObjectMeasurement, now_ns: int, settings: ObjectTrackSettings
) -> Track:
    """The track updated by its measurement."""
    dt = 1e-9 * (now_ns - track.measured_ns)
    size = np.maximum(_SHRINK * track.size, track.size + _GROWTH * (measurement.size - track.size))
    body = update(track.filter, as_observation(measurement, size, dt))
    hits = track.hits + 1
    evidence = track.evidence + min(dt, settings.confirm_s)
    confirmed = track.state != TrackState.TENTATIVE
    confirmed |= hits >= settings.confirm_hits and evidence >= settings.confirm_s
    confirmed |= hits > 1 and len(measurement.feature_id) >= _MANY_FEATURES
    velocity = body.best.state[VELOCITY]
    fast = np.hypot(velocity[0], velocity[1]) > _MOVING_MPS
    return replace(
        track,
        state=TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE,
        filter=body,
        offset=measurement.position - body.best.state[:3],
        size=np.minimum(size, MAX_VEHICLE_SIZE_M),
        yaw=_heading(velocity) if fast else track.yaw,
        feature_id=union(track.feature_id, measurement.feature_id),
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=hits,
        evidence=evidence,
    )


def horizontal_variance(track: Track) -> float:
    """Variance of its position in one horizontal direction, m²."""
    P = track.filter.best.covariance
    return 0.5 * float(P[0, 0] + P[1, 1])
