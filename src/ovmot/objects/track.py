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
from ovmot.objects.motion_class import CLASSES, SpeedHistory, no_history
from ovmot.objects.motion_evidence import Origin, body_log_ratio, carried_origin
from ovmot.objects.reappearance import body_seen_again
from ovmot.objects.reported_place import AT_ITS_PLACE, lag_after
from ovmot.physics import STEADY_S, TRIP_SHARES
from ovmot.settings import ObjectTrackSettings

CENTRE_SHARE = 0.25
"""Of the size: standard deviation of the centre of the seen points from that of the body."""
LEAST_CENTRE_SIGMA_M = 0.2
"""The same of what is small."""
DRIVES_MPS = 3.0
"""Faster than who walks."""


class TrackState(StrEnum):
    """How sure a track is of its body."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


class Track(NamedTuple):
    """A body that was seen to move; world axes, SI.

    `origin`: where its filter began. `least_size` (3,): what was seen of it before it was lost and
    found again. `measured_ns`: time of the last measurement, `updated_ns`: of the last update of
    any kind. `remeasured`: in how many frames it was measured again. `log_ratio`: of the likelihood
    that it moves over that it rests, as long as it is tentative. `overlaps`: frames in a row in
    which it was a duplicate of an older track. `speeds`: of its class of motion, which has the
    probabilities `class_probability` (3,). `whole`: is its box in view as a whole? `lag` (3,): of
    the reported centre.
    """

    track_id: int
    state: TrackState
    body: Body
    origin: Origin
    heading: Heading
    box: Box
    least_size: FloatArray
    born_ns: int
    measured_ns: int
    updated_ns: int
    remeasured: int
    log_ratio: float
    speeds: SpeedHistory
    class_probability: FloatArray
    whole: bool = False
    lag: FloatArray = AT_ITS_PLACE
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
    def kind(self) -> int:
        """Its most probable class of motion, of `CLASSES`: its box has the usual size of that.

        What drives is a vehicle until one of its sides was in view: its speed may be anyone's. What
        does not drive, and is not as wide as a vehicle where its width was in view, are walkers
        side by side.
        """
        vehicle, kind = CLASSES.index("vehicle"), int(np.argmax(self.class_probability))
        shown = self.box.shown.faces
        if self.heading.drives and not shown[:2].any():
            return vehicle
        side_by_side = kind == vehicle and shown[1] and not self.box.is_vehicle
        return CLASSES.index("walker") if side_by_side else kind

    @property
    def yaw(self) -> float:
        """Heading of the box."""
        return self.box.yaw

    @property
    def feature_id(self) -> IntArray:
        """The features that are followed, rising."""
        return self.body.members


def start_track(
    track_id: int,
    frame: FrameViews,
    body: Body,
    origin: Origin,
    n_free: int,
    settings: ObjectTrackSettings,
) -> Track:
    """A track of a new body, of a measurement that is associated with no other one, and of which
    `n_free` features are no other track's."""
    camera = frame.step.centre
    heading = updated_heading(new_heading(), body, body.state.x[:3], camera, False, False, 0.1)
    now_ns = frame.timestamp_ns
    box = box_of(body, int(np.argmax(TRIP_SHARES)), heading, np.zeros(3), camera)
    track = Track(
        track_id=track_id,
        state=TrackState.TENTATIVE,
        body=body,
        origin=origin,
        heading=heading,
        box=box,
        least_size=np.zeros(3),
        born_ns=now_ns,
        measured_ns=now_ns,
        updated_ns=now_ns,
        remeasured=0,
        log_ratio=0.0,
        speeds=no_history(),
        class_probability=np.array(TRIP_SHARES) / sum(TRIP_SHARES),
    )
    return _tested(track, frame, min(body.n_used, n_free), settings)


def _tested(
    track: Track, frame: FrameViews, n_features: int, settings: ObjectTrackSettings
) -> Track:
    """The track, confirmed if it is tentative and its body moves by all that was seen of it."""
    if track.state != TrackState.TENTATIVE:
        return track
    ratio = body_log_ratio(track.body, track.origin, frame, n_features, track.remeasured)
    state = TrackState.CONFIRMED if ratio >= _upper_bound(settings) else TrackState.TENTATIVE
    return track._replace(state=state, log_ratio=ratio)


def moves(body: Body, origin: Origin, frame: FrameViews, settings: ObjectTrackSettings) -> bool:
    """Would a new body be confirmed at once?"""
    return body_log_ratio(body, origin, frame, body.n_used, 0) >= _upper_bound(settings)


def _upper_bound(settings: ObjectTrackSettings) -> float:
    """Of the log-ratio, from which a body moves (Wald, 1945)."""
    return math.log((1.0 - settings.miss) / settings.false_alarm)


def rests(track: Track, settings: ObjectTrackSettings) -> bool:
    """Does the body of a tentative track rest, by all that was seen of it?"""
    bound = math.log(settings.miss / (1.0 - settings.false_alarm))
    return track.state == TrackState.TENTATIVE and track.log_ratio <= bound


def advance_track(track: Track, frame: FrameViews, settings: ObjectTrackSettings) -> Track:
    """The track predicted to a frame, updated by its features, and tested if it is tentative."""
    now, before = _updated(track, frame, settings), track.box
    dt = 1e-9 * (frame.timestamp_ns - track.body.timestamp_ns)
    # the estimate of a new body converges: its reported centre goes with it
    age_s = 1e-9 * (track.body.timestamp_ns - track.born_ns)
    smoothing_s = min(age_s, settings.smoothing_s)
    return now._replace(lag=lag_after(track.lag, before, now.box, dt, smoothing_s))


def _updated(track: Track, frame: FrameViews, settings: ObjectTrackSettings) -> Track:
    """The same but for its lag."""
    track = track._replace(origin=carried_origin(track.origin, frame.correction))
    body = _advanced(track, frame)
    dt = 1e-9 * (frame.timestamp_ns - track.body.timestamp_ns)
    if body.n_used < LEAST_SEEN:
        return _unseen(track, body)
    state = TrackState.CONFIRMED if track.state == TrackState.COASTING else track.state
    if not body.map.outline.any():  # only features that joined it are left: its box goes with it
        return _unseen(track, body)._replace(state=state, updated_ns=frame.timestamp_ns)
    camera = frame.step.centre
    heading = updated_heading(
        track.heading, body, track.position, camera, track.whole, _is_vehicle(track), dt
    )
    # the box changes slowly in the body's frame, as more of it is seen
    age_s = 1e-9 * (frame.timestamp_ns - track.born_ns)
    gain = 1.0 - math.exp(-dt / max(min(age_s, STEADY_S), dt))
    box = steady_box(
        body, track.kind, track.body, heading, track.box, track.least_size, camera, gain
    )
    track = track._replace(
        body=body, state=state, heading=heading, box=box, updated_ns=frame.timestamp_ns
    )
    return _tested(track, frame, track.body.n_used, settings)


def _is_vehicle(track: Track) -> bool:
    return track.kind == CLASSES.index("vehicle")


def _advanced(track: Track, frame: FrameViews) -> Body:
    """Its body predicted to the frame and updated there. One that is out of sight, or nearly, is
    where its lost features are seen again."""
    body = advance(track.body, frame)
    if body.n_used > LEAST_SEEN or track.state == TrackState.TENTATIVE:
        return body
    unseen_s = 1e-9 * (frame.timestamp_ns - track.updated_ns)
    return body_seen_again(body, track.body.map, frame, unseen_s)


def _unseen(track: Track, body: Body) -> Track:
    """A track whose body was predicted only; its box goes with it."""
    box = carried_box(body, track.body, track.box)
    state = track.state if track.state == TrackState.TENTATIVE else TrackState.COASTING
    return track._replace(body=body, state=state, box=box)


def with_box(track: Track, frame: FrameViews) -> Track:
    """The track with the box of its map, if that has an outline."""
    if not track.body.map.outline.any():
        return track
    return track._replace(
        box=box_of(track.body, track.kind, track.heading, track.least_size, frame.step.centre)
    )


def measured_track(
    track: Track, own: IntArray, frame: FrameViews, settings: ObjectTrackSettings
) -> Track:
    """The track, tested, with those features of its measurement that are its `own` (k,)."""
    track = track._replace(
        body=with_members(track.body, frame, own),
        measured_ns=frame.timestamp_ns,
        updated_ns=frame.timestamp_ns,
        remeasured=track.remeasured + 1,
    )
    return _tested(track, frame, track.body.n_used, settings)


def found_again(track: Track, body: Body, origin: Origin, frame: FrameViews) -> Track:
    """A track that was lost, with a new body in its place, no smaller than was seen of it."""
    camera = frame.step.centre
    heading = new_heading()._replace(shown=track.heading.shown, drives=track.heading.drives)
    heading = updated_heading(heading, body, body.state.x[:3], camera, False, False, 0.1)
    least = np.maximum(track.least_size, track.box.shown.extent)
    found = track._replace(
        body=body, origin=origin, heading=heading, least_size=least, lag=AT_ITS_PLACE
    )
    return with_box(found, frame)


def horizontal_variance(track: Track) -> float:
    """Variance of its position in one horizontal direction, m²."""
    P = track.body.state.P
    return 0.5 * float(P[0, 0] + P[1, 1])
