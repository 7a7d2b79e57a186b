"""Tracks of moving bodies over time: predict, associate, update, start, drop, merge."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained, union, without
from ovmot.kernels.table_kernel import columns_of_compiled
from ovmot.objects.association import associate
from ovmot.objects.feature_motions import FeatureHistory, FeatureMotions, moving_with
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.merging import merge_duplicates
from ovmot.objects.monocular_points import with_track_depths
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.output import to_object_track
from ovmot.objects.point_labels import label_points, speeds_of
from ovmot.objects.track import (
    Track,
    TrackState,
    horizontal_variance,
    predict_track,
    start_track,
    update_track,
)
from ovmot.objects.track_box import is_in_view, points_in_boxes
from ovmot.objects.unmeasured import recovery_candidates, update_unmeasured
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
        timestamp_ns: int,
        measurements: Sequence[ObjectMeasurement],
        points: ScenePoints,
        T_world_cam0: FloatArray,
        pixel_sigma: float,
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        """The tracks of this frame, and its points with their tracks' ids and labels.

        `pixel_sigma`: standard deviation of a pixel coordinate of the points.
        """
        settings, rig = self._settings, self._rig
        # 1 predict the tracks, and measure each feature's motion
        tracks = [predict_track(track, timestamp_ns) for track in self._tracks]
        motions = self._feature_motions(timestamp_ns, points, tracks, T_world_cam0, pixel_sigma)
        # 2 associate measurements with tracks
        out_of_view = np.array([_has_left(t, T_world_cam0, rig) for t in tracks], dtype=np.bool_)
        matches = associate(tracks, measurements, out_of_view, timestamp_ns)
        # 3 update tracks by their measurements, the others by their features
        tracks = self._updated(tracks, measurements, matches, motions, timestamp_ns)
        # 4 start tracks by the other measurements
        for j in sorted(set(range(len(measurements))) - set(matches.values())):
            tracks.append(start_track(self._next_id, timestamp_ns, measurements[j]))
            self._next_id += 1
        # 5 drop lost tracks, update the sets of features, merge duplicates
        alive = [track for track in tracks if _is_alive(track, timestamp_ns, settings)]
        self._tracks = merge_duplicates(_with_current_features(alive, motions), settings)
        # 6 convert for the output, label the points
        track_id = _track_ids(self._tracks, points.feature_id)
        output = tuple(
            to_object_track(t, timestamp_ns, points, track_id, T_world_cam0, rig)
            for t in self._tracks
        )
        before, self._speeds = self._speeds, speeds_of(timestamp_ns, self._tracks)
        return output, label_points(timestamp_ns, points, track_id, self._tracks, motions, before)

    def _feature_motions(
        self,
        now_ns: int,
        points: ScenePoints,
        tracks: Sequence[Track],
        T_world_cam0: FloatArray,
        pixel_sigma: float,
    ) -> FeatureMotions:
        """Motions of the features of this frame; those of tracks need the left camera only."""
        since_s, self._last_ns = 1e-9 * (now_ns - self._last_ns), now_ns
        before = self._history.last
        placed = with_track_depths(
            points, tracks, before, since_s, T_world_cam0, self._rig, pixel_sigma
        )
        return self._history.add(now_ns, placed, T_world_cam0)

    def _updated(
        self,
        tracks: Sequence[Track],
        measurements: Sequence[ObjectMeasurement],
        matches: Mapping[int, int],
        motions: FeatureMotions,
        now_ns: int,
    ) -> list[Track]:
        """The tracks, each updated by its measurement, or else by its features."""
        by_features = tracks if len(matches) < len(tracks) else []
        in_box = points_in_boxes(by_features, motions.p_world, motions.position_cov)
        held = _track_ids(by_features, motions.feature_id)
        candidate = recovery_candidates(by_features, in_box, held)
        return [
            update_track(track, measurements[matches[i]], now_ns, self._settings)
            if i in matches
            else update_unmeasured(track, motions, in_box[i], candidate[i], now_ns)
            for i, track in enumerate(tracks)
        ]

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


def _with_current_features(tracks: Sequence[Track], motions: FeatureMotions) -> list[Track]:
    """The tracks with the features that they hold now.

    Features in a track's box with its velocity join, those far off it leave, as do those that are
    not seen any more. Of two tracks the older one keeps a common feature.
    """
    held = _track_ids(tracks, motions.feature_id)
    in_boxes = points_in_boxes(tracks, motions.p_world, motions.position_cov)
    joined = [_with_joining(t, motions, held, at) for t, at in zip(tracks, in_boxes, strict=True)]
    out, taken, in_view = [], np.empty(0, dtype=np.int64), np.sort(motions.feature_id)
    for track in joined:
        ids = track.feature_id
        if track.state != TrackState.COASTING:
            ids = ids[contained(ids, in_view) & ~contained(ids, taken)]
        taken = union(taken, ids)
        out.append(track if len(ids) == len(track.feature_id) else replace(track, feature_id=ids))
    return out


def _with_joining(
    track: Track, motions: FeatureMotions, track_id: IntArray, in_box: BoolArray
) -> Track:
    """The track with the free features in its box that have its velocity, without those outside.

    `track_id` (N,): the track that holds each feature; `in_box` (N,): which are in its box.
    """
    if track.state == TrackState.COASTING:
        return track
    ids = track.feature_id
    if track.state == TrackState.CONFIRMED:
        free = in_box & ((track_id < 0) | (track_id == track.track_id))
        P = track.filter.best.covariance[VELOCITY, VELOCITY]
        ids = union(ids, motions.feature_id[moving_with(motions, free, track.velocity, P)])
    outside = ~in_box & np.isfinite(motions.p_world[:, 0])
    return replace(track, feature_id=without(ids, motions.feature_id[outside]))


def _track_ids(tracks: Sequence[Track], feature_id: IntArray) -> IntArray:
    """The track that holds each feature (N,), by id; -1 for none. Coasting tracks hold none."""
    holding = [t for t in reversed(tracks) if t.state != TrackState.COASTING]
    if not holding:
        return np.full(len(feature_id), -1, dtype=np.int64)
    held = np.concatenate([t.feature_id for t in holding])
    owner = np.repeat([t.track_id for t in holding], [len(t.feature_id) for t in holding])
    at = columns_of_compiled(feature_id, held)  # the first of equal ids, so that of the last track
    return np.where(at >= 0, np.append(owner, -1)[at], -1)
