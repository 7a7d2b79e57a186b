"""Tracks of moving bodies over time: predict, associate, update, start, drop, merge."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained, union
from ovmot.kernels.table_kernel import columns_of_compiled
from ovmot.objects.association import associate
from ovmot.objects.body import with_members, without_members
from ovmot.objects.body_box import distance_to_hull, may_belong
from ovmot.objects.body_step_kernel import Body, FrameViews
from ovmot.objects.feature_motions import (
    CLEARLY,
    FeatureHistory,
    FeatureMotions,
    distances_from_rest_and_body,
    moving_with,
)
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.merging import BESIDE_NS, merge_duplicates
from ovmot.objects.output import to_object_track
from ovmot.objects.point_labels import label_points, speeds_of
from ovmot.objects.track import (
    LEAST_SEEN,
    Track,
    TrackState,
    advance_track,
    filled_track,
    found_again,
    horizontal_variance,
    measured_track,
    start_track,
)
from ovmot.objects.track_box import is_in_view, points_in_boxes
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, ScenePoints

_TENTATIVE_MISSES_S = 0.25
_LOST_M = 1.0  # standard deviation of a lost track's position


class ObjectTracker:
    """Keeps the tracks, and the next id: ids are never used again."""

    def __init__(self, rig: StereoRig, settings: ObjectTrackSettings) -> None:
        self._rig = rig
        self._settings = settings
        self._tracks: tuple[Track, ...] = ()
        self._history = FeatureHistory()
        self._next_id = 0
        self._last_ns = 0
        self._speeds = speeds_of(0, ())

    def step(
        self,
        frame: FrameViews,
        measurements: Sequence[ObjectMeasurement],
        points: ScenePoints,
        new_body: Callable[[ObjectMeasurement], Body],
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        """The tracks of this frame, and its points with their tracks' ids and labels.

        `new_body` starts a body by its measurement.
        """
        settings, rig, now_ns = self._settings, self._rig, frame.timestamp_ns
        T_world_cam0 = frame.T_world_cam0
        # 1 predict the tracks and update them by their features
        tracks = [advance_track(track, frame) for track in self._tracks]
        motions = self._history.add(now_ns, points, T_world_cam0)
        # 2 associate measurements with tracks: those bring features, and find lost tracks again
        out_of_view = np.array([_has_left(t, T_world_cam0, rig) for t in tracks], dtype=np.bool_)
        matches = associate(tracks, measurements, out_of_view, now_ns)
        for i, j in matches.items():
            if tracks[i].state == TrackState.COASTING or tracks[i].body.n_used < LEAST_SEEN:
                body = new_body(measurements[j])
                if body.map.outline.any():
                    tracks[i] = found_again(tracks[i], body, frame)
            own = _own_features(tracks, i, measurements[j], frame)
            tracks[i] = measured_track(tracks[i], measurements[j], own, frame, settings)
        # 3 find others again by features in their boxes
        tracks = _recovered(tracks, motions, frame)
        # 4 start tracks by the other measurements
        for j in sorted(set(range(len(measurements))) - set(matches.values())):
            body = new_body(measurements[j])
            if body.map.outline.any():
                tracks.append(start_track(self._next_id, frame, measurements[j], body))
                self._next_id += 1
        # 5 drop lost tracks, update the sets of features, merge duplicates
        alive = [_missed(t, frame) for t in tracks if _is_alive(t, now_ns, settings)]
        alive = _with_joining_features(alive, motions, frame)
        self._tracks = tuple(filled_track(t, frame) for t in merge_duplicates(alive))
        # 6 convert for the output, label the points
        track_id = _track_ids(self._tracks, points.feature_id)
        output = tuple(
            to_object_track(t, now_ns, points, track_id, T_world_cam0, rig) for t in self._tracks
        )
        before, self._speeds = self._speeds, speeds_of(now_ns, self._tracks)
        return output, label_points(now_ns, points, track_id, self._tracks, motions, before)

    def with_track_ids(self, points: ScenePoints) -> ScenePoints:
        """The points of a new frame with the tracks that held their features until now.

        Those of confirmed tracks only, and not of duplicates, whose features are of another track.
        """
        sure = [t for t in self._tracks if t.state == TrackState.CONFIRMED and t.overlaps == 0]
        return replace(points, track_id=_track_ids(sure, points.feature_id))

    def predicted_velocities(self, points: ScenePoints) -> tuple[IntArray, FloatArray]:
        """Features of this frame (N,) that move on with a track, and its velocity (N, 3), world."""
        velocity = np.full((len(points.feature_id), 3), np.nan)
        motions = self._history.last
        in_boxes = points_in_boxes(self._tracks, motions.p_world, motions.position_cov)
        for track, in_box in zip(self._tracks, in_boxes & ~motions.known, strict=True):
            own = contained(motions.feature_id, track.feature_id)
            velocity[own | in_box] = track.velocity
        known = np.isfinite(velocity[:, 0])
        return points.feature_id[known], velocity[known]


def _has_left(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Does a track coast outside the image, its position hardly known any more?"""
    if track.state != TrackState.COASTING or is_in_view(track, T_world_cam0, rig):
        return False
    return horizontal_variance(track) > _LOST_M**2


def _is_alive(track: Track, now_ns: int, settings: ObjectTrackSettings) -> bool:
    """A tentative track needs measurements; the others live on unseen for a while."""
    unseen_s = 1e-9 * (now_ns - track.updated_ns)
    if track.state == TrackState.TENTATIVE:
        return unseen_s <= _TENTATIVE_MISSES_S
    return unseen_s <= settings.coast_s


def _own_features(
    tracks: Sequence[Track], i: int, measurement: ObjectMeasurement, frame: FrameViews
) -> IntArray:
    """The features (k,) of track i's measurement that may be of its body, and are no nearer to
    another one."""
    ids = measurement.feature_id
    at = columns_of_compiled(ids, frame.feature_id)
    p, C = frame.p_world[at], frame.cov_world[at]
    own = may_belong(tracks[i].box, p, np.sqrt(np.einsum("nii->n", C)))
    distance = distance_to_hull(tracks[i].box, p)
    for k, other in enumerate(tracks):
        if k != i and other.state == TrackState.CONFIRMED:
            own &= distance <= distance_to_hull(other.box, p)
    return ids[own]


def _missed(track: Track, frame: FrameViews) -> Track:
    """A tentative track must be measured in consecutive frames: its count begins again."""
    if track.state == TrackState.TENTATIVE and track.measured_ns < frame.timestamp_ns:
        return replace(track, hits=0, evidence=0.0)
    return track


def _recovered(tracks: Sequence[Track], motions: FeatureMotions, frame: FrameViews) -> list[Track]:
    """The tracks, those that were lost with the features in their boxes that move as they do."""
    lost = [t for t in tracks if t.state == TrackState.COASTING]
    if not lost:
        return list(tracks)
    in_box = points_in_boxes(tracks, motions.p_world, motions.position_cov)
    candidate = recovery_candidates(tracks, in_box, _track_ids(tracks, motions.feature_id))
    return [
        _joined_by(track, motions, own, frame) if track.state == TrackState.COASTING else track
        for track, own in zip(tracks, candidate, strict=True)
    ]


def _joined_by(
    track: Track, motions: FeatureMotions, candidate: BoolArray, frame: FrameViews
) -> Track:
    """A lost track, found again if enough of the `candidate` features (N,) move as it does."""
    own = moving_with(motions, candidate, track.velocity, track.velocity_cov)
    if own.sum() < LEAST_SEEN:
        return track
    body = with_members(track.body, frame, motions.feature_id[own])
    return replace(track, body=body, state=TrackState.CONFIRMED, updated_ns=frame.timestamp_ns)


def _with_joining_features(
    tracks: Sequence[Track], motions: FeatureMotions, frame: FrameViews
) -> list[Track]:
    """The tracks with the features that they hold now.

    Free features in a track's box that move as it does and do not rest join it; those that clearly
    rest leave it. Of two tracks the older one keeps a common feature.
    """
    held = _track_ids(tracks, motions.feature_id)
    in_boxes = points_in_boxes(tracks, motions.p_world, motions.position_cov)
    out, taken = [], np.empty(0, dtype=np.int64)
    for track, in_box in zip(tracks, in_boxes, strict=True):
        body = _without_static(track, motions)
        if track.state == TrackState.CONFIRMED:
            free = in_box & (held < 0)
            free[free] = ~contained(motions.feature_id[free], taken)
            joins = moving_with(motions, free, track.velocity, track.velocity_cov)
            body = with_members(body, frame, motions.feature_id[joins], outline=False)
        if len(taken):
            body = without_members(body, taken)
        taken = union(taken, body.members)
        out.append(replace(track, body=body))
    return out


def _without_static(track: Track, motions: FeatureMotions) -> Body:
    """A track's body without features that clearly rest while it moves: what lies behind it."""
    if track.state == TrackState.COASTING:
        return track.body
    own = contained(motions.feature_id, track.feature_id)
    from_rest, from_body, _ = distances_from_rest_and_body(
        motions, own, track.velocity, track.velocity_cov
    )
    static = np.zeros(len(own), dtype=np.bool_)
    static[own] = from_rest[own] + CLEARLY < from_body[own]
    return without_members(track.body, motions.feature_id[static])


def _track_ids(tracks: Sequence[Track], feature_id: IntArray) -> IntArray:
    """The track that holds each feature (N,), by id; -1 for none. Coasting tracks hold none."""
    holding = [t for t in reversed(tracks) if t.state != TrackState.COASTING]
    if not holding:
        return np.full(len(feature_id), -1, dtype=np.int64)
    held = np.concatenate([t.feature_id for t in holding])
    owner = np.repeat([t.track_id for t in holding], [len(t.feature_id) for t in holding])
    at = columns_of_compiled(feature_id, held)  # the first of equal ids, so that of the last track
    return np.where(at >= 0, np.append(owner, -1)[at], -1)


def recovery_candidates(
    tracks: Sequence[Track], in_box: BoolArray, track_id: IntArray
) -> BoolArray:
    """Features (T, N) by which each track may be found again.

    Those in its box, `in_box` (T, N), that no other track holds by `track_id` (N,), and that are
    not in the box of a body that was seen beside it.
    """
    in_view = np.array([t.state == TrackState.CONFIRMED for t in tracks], dtype=np.bool_)
    born = np.array([t.born_ns for t in tracks], dtype=np.int64)
    updated = np.array([t.updated_ns for t in tracks], dtype=np.int64)
    beside = in_view & (born + BESIDE_NS < updated[:, None])
    np.fill_diagonal(beside, False)
    own_id = np.array([t.track_id for t in tracks], dtype=np.int64)
    candidate: BoolArray = (
        in_box & ~(beside @ in_box) & ((track_id < 0) | (track_id == own_id[:, None]))
    )
    return candidate
