"""One track of a body: the body, its box, and how it is started, predicted and updated."""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.body import LEAST_SEEN, advance, with_members
from ovmot.objects.body_box import box_of, carried_box, new_heading, steady_box, updated_heading
from ovmot.objects.body_box_kernel import Box, Heading
from ovmot.objects.body_step_kernel import Body, FrameViews
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.physics import LENS_SCALE_SIGMA, LENS_SIGMA_PX, gate
from ovmot.settings import ObjectTrackSettings

CENTRE_SHARE = 0.25
"""Of the size: standard deviation of the centre of the seen points from that of the body."""
LEAST_CENTRE_SIGMA_M = 0.2
"""The same of what is small."""
DRIVES_MPS = 3.0
"""Faster than who walks."""
_MANY_FEATURES = 5  # with one velocity are not by chance: two measurements are enough
ACROSS_SHARE = 0.5
"""Of the velocity along the ray, that one across it must be at least."""
_STEADY_S = 1.0  # over which a box takes on what was newly seen


class TrackState(StrEnum):
    """How sure a track is of its body."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


class Track(NamedTuple):
    """A body that was seen to move; world axes, SI.

    `least_size` (3,): the size that it had before it was lost and found again. `hits` counts
    measurements, `evidence` the seconds that they span; `measured_ns`: time of the last
    measurement, `updated_ns`: of the last update of any kind. `overlaps`: frames in a row in which
    it was a duplicate of an older track.
    """

    track_id: int
    state: TrackState
    body: Body
    heading: Heading
    box: Box
    least_size: FloatArray
    born_ns: int
    measured_ns: int
    updated_ns: int
    hits: int
    evidence: float
    overlaps: int = 0

    @property
    def position(self) -> FloatArray:
        """Centre (3,) of the box, in world."""
        return self.box.centre

    @property
    def velocity(self) -> FloatArray:
        """Velocity (3,) of the box's centre in world, m/s."""
        return self.box.velocity

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of position and velocity, without that of the box."""
        return self.box.covariance

    @property
    def velocity_cov(self) -> FloatArray:
        """Covariance (3, 3) of the velocity."""
        return self.box.covariance[3:, 3:]

    @property
    def size(self) -> FloatArray:
        """Length, width, height (3,) of the box."""
        return self.box.size

    @property
    def yaw(self) -> float:
        """Heading of the box."""
        return self.box.yaw

    @property
    def feature_id(self) -> IntArray:
        """The features that are followed, rising."""
        return self.body.members


def start_track(
    track_id: int, frame: FrameViews, measurement: ObjectMeasurement, body: Body
) -> Track:
    """A track of a new body, from a measurement that is associated with no other one."""
    camera = frame.step.centre
    heading = updated_heading(new_heading(), body, measurement.position, camera, 0.1)
    box = box_of(body, heading, np.zeros(3), camera)
    now_ns = frame.timestamp_ns
    sure = is_conclusive(measurement) and moves_for_sure(measurement, now_ns, frame)
    return Track(
        track_id=track_id,
        state=TrackState.CONFIRMED if sure else TrackState.TENTATIVE,
        body=body,
        heading=heading,
        box=box,
        least_size=np.zeros(3),
        born_ns=now_ns,
        measured_ns=now_ns,
        updated_ns=now_ns,
        hits=1,
        evidence=0.0,
    )


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


def moves_for_sure(measurement: ObjectMeasurement, born_ns: int, frame: FrameViews) -> bool:
    """Is more seen of a motion, since a track was born and its measurement's span before, than the
    lens models leave in doubt?"""
    seconds = measurement.span_s + 1e-9 * (frame.timestamp_ns - born_ns)
    C = measurement.covariance[3:, 3:] + lens_doubt(measurement.position, seconds, frame)
    v = measurement.velocity
    return float(v @ np.linalg.solve(C, v)) > gate(3, 0.99)


def lens_doubt(position: FloatArray, seconds: float, frame: FrameViews) -> FloatArray:
    """Covariance (3, 3) that lens models give to a velocity over some seconds, m²/s².

    Their errors are common to features that are near each other: many of them know a motion no
    better than one. In a corner where the calibration had no board, what stands seems to move along
    its ray, by the disparity's error at both times in both cameras; and across it, by a share of
    the way that the rig's turning takes it through the image.
    """
    ray = position - frame.step.centre
    distance = float(np.linalg.norm(ray))
    ray = ray / distance
    moved_px = math.sqrt(2.0 * 2.0) * LENS_SIGMA_PX
    along = moved_px * distance**2 / (frame.focal * frame.baseline * seconds)
    across = LENS_SCALE_SIGMA * frame.turn_rate_rps * distance
    return across**2 * np.eye(3) + (along**2 - across**2) * np.outer(ray, ray)


def advance_track(track: Track, frame: FrameViews) -> Track:
    """The track predicted to a frame and updated by its features."""
    body = advance(track.body, frame)
    dt = 1e-9 * (frame.timestamp_ns - track.body.timestamp_ns)
    if body.n_used < LEAST_SEEN:
        return _unseen(track, body)
    state = TrackState.CONFIRMED if track.state == TrackState.COASTING else track.state
    if not body.map.outline.any():  # only features that joined it are left: its box goes with it
        return _unseen(track, body)._replace(state=state, updated_ns=frame.timestamp_ns)
    camera = frame.step.centre
    heading = updated_heading(track.heading, body, track.position, camera, dt)
    # the box changes slowly in the body's frame, as more of it is seen
    age_s = 1e-9 * (frame.timestamp_ns - track.born_ns)
    gain = 1.0 - math.exp(-dt / max(min(age_s, _STEADY_S), dt))
    box = steady_box(body, track.body, heading, track.box, track.least_size, camera, gain)
    return track._replace(
        body=body, state=state, heading=heading, box=box, updated_ns=frame.timestamp_ns
    )


def _unseen(track: Track, body: Body) -> Track:
    """A track whose body was predicted only; its box goes with it."""
    box = carried_box(body, track.body, track.box)
    state = track.state if track.state == TrackState.TENTATIVE else TrackState.COASTING
    return track._replace(body=body, state=state, box=box)


def with_box(track: Track, frame: FrameViews) -> Track:
    """The track with the box of its map."""
    return track._replace(
        box=box_of(track.body, track.heading, track.least_size, frame.step.centre)
    )


def measured_track(
    track: Track,
    measurement: ObjectMeasurement,
    own: IntArray,
    frame: FrameViews,
    settings: ObjectTrackSettings,
) -> Track:
    """The track with those features of its measurement that are its `own` (k,)."""
    dt = 1e-9 * (frame.timestamp_ns - track.measured_ns)
    hits = track.hits + 1
    evidence = track.evidence + min(dt, settings.confirm_s)
    often = hits >= settings.confirm_hits and evidence >= settings.confirm_s
    often |= hits > 1 and len(measurement.feature_id) >= _MANY_FEATURES
    confirmed = track.state != TrackState.TENTATIVE
    confirmed |= often and moves_for_sure(measurement, track.born_ns, frame)
    return track._replace(
        state=TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE,
        body=with_members(track.body, frame, own),
        measured_ns=frame.timestamp_ns,
        updated_ns=frame.timestamp_ns,
        hits=hits,
        evidence=evidence,
    )


def found_again(track: Track, body: Body, frame: FrameViews) -> Track:
    """A track that was lost, with a new body in its place; its size stays."""
    camera = frame.step.centre
    heading = new_heading()._replace(shown=track.heading.shown, drives=track.heading.drives)
    heading = updated_heading(heading, body, body.state.x[:3], camera, 0.1)
    found = track._replace(body=body, heading=heading, least_size=track.box.size)
    return with_box(found, frame)


def horizontal_variance(track: Track) -> float:
    """Variance of its position in one horizontal direction, m²."""
    P = track.body.state.P
    return 0.5 * float(P[0, 0] + P[1, 1])
