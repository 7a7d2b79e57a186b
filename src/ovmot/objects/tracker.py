"""Tracks of moving bodies over time: predict, associate, update, start, drop, merge."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.interfaces import HiddenFeatures
from ovmot.objects.association import associate
from ovmot.objects.body import LEAST_SEEN, ROAD_USERS, VelocityPrior, prior_of
from ovmot.objects.body_step_kernel import Body, FrameViews
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.merging import merge_duplicates
from ovmot.objects.motion_evidence import Origin
from ovmot.objects.output import to_object_tracks
from ovmot.objects.point_labels import label_points, speeds_of
from ovmot.objects.track import (
    Track,
    TrackState,
    advance_track,
    found_again,
    horizontal_variance,
    measured_track,
    moves,
    rests,
    start_track,
    with_box,
)
from ovmot.objects.track_box import is_in_view
from ovmot.objects.track_class import with_classes
from ovmot.objects.track_features import (
    are_seen,
    held_by,
    hidden_features,
    hidden_places,
    hulls_of,
    ids_of,
    own_features,
    owners,
    recovered,
    velocities_of_members,
    with_exchanged_features,
)
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, ScenePoints

_TENTATIVE_UNSEEN_S = 0.25
_LOST_M = 1.0  # standard deviation of a lost track's position


class ObjectTracker:
    """Keeps the tracks, and the next id: ids are never used again."""

    def __init__(self, rig: StereoRig, settings: ObjectTrackSettings) -> None:
        self._rig = rig
        self._settings = settings
        self._tracks: tuple[Track, ...] = ()
        self._held, self._hulls = held_by(()), hulls_of(())
        self._next_id = 0
        self._speeds = speeds_of(())

    def step(
        self,
        frame: FrameViews,
        measurements: Sequence[ObjectMeasurement],
        points: ScenePoints,
        motions: FeatureMotions,
        new_body: Callable[[ObjectMeasurement, VelocityPrior], tuple[Body, Origin]],
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        """The tracks of this frame, and its points with their tracks' ids and labels.

        `motions` are those of its features. `new_body` starts a body by its measurement and a prior
        of its velocity.
        """
        settings, rig, now_ns = self._settings, self._rig, frame.timestamp_ns
        T_world_cam0 = frame.T_world_cam0
        # 1 predict the tracks and update them by their features
        tracks = [advance_track(track, frame, settings) for track in self._tracks]
        # 2 associate measurements with tracks: those bring features, and find lost tracks again
        matches = {
            i: j
            for i, j in associate(tracks, measurements, now_ns).items()
            if not _has_left(tracks[i], T_world_cam0, rig)
            or moves(*new_body(measurements[j], ROAD_USERS), frame, settings)
        }
        for i, j in matches.items():
            if tracks[i].state == TrackState.COASTING or tracks[i].body.n_used < LEAST_SEEN:
                body, origin = new_body(measurements[j], prior_of(tracks[i].body))
                if body.map.outline.any():
                    tracks[i] = found_again(tracks[i], body, origin, frame)
        hulls = hulls_of(tracks)
        for i, j in matches.items():
            own = own_features(tracks, hulls, i, measurements[j].feature_id, frame)
            tracks[i] = measured_track(tracks[i], own, frame, settings)
        # 3 find others again by features in their boxes
        tracks = recovered(tracks, motions, frame)
        # 4 start tracks by the other measurements
        held = held_by(tracks).ids
        for j in sorted(set(range(len(measurements))) - set(matches.values())):
            body, origin = new_body(measurements[j], ROAD_USERS)
            if body.map.outline.any():
                n_free = int(np.isin(measurements[j].feature_id, held, invert=True).sum())
                tracks.append(start_track(self._next_id, frame, body, origin, n_free, settings))
                self._next_id += 1
        # 5 drop lost tracks, update the sets of features, merge duplicates
        alive = [t for t in tracks if _is_alive(t, now_ns, settings)]
        hulls = hulls_of(alive)
        tracks = with_exchanged_features(alive, hulls, motions, frame)
        self._tracks = with_classes(merge_duplicates(tracks, hulls), T_world_cam0, rig)
        # 6 the boxes of new tracks have the sizes of their classes
        self._tracks = tuple(with_box(t, frame) if t.born_ns == now_ns else t for t in self._tracks)
        # 7 convert for the output, label the points
        self._held = held_by(self._tracks)
        owner = owners(self._held, are_seen(self._tracks), points.feature_id)
        output = to_object_tracks(self._tracks, now_ns, points.pixels, owner, T_world_cam0, rig)
        before, self._speeds = self._speeds, speeds_of(self._tracks)
        self._hulls = hulls_of(self._tracks)
        labelled = label_points(points, owner, self._tracks, self._hulls, motions, before)
        return output, labelled

    def with_track_ids(self, points: ScenePoints) -> ScenePoints:
        """The points of a new frame with the tracks that held their features until now.

        Those of confirmed tracks only, and not of duplicates, whose features are of another track.
        """
        sure = [t.state == TrackState.CONFIRMED and t.overlaps == 0 for t in self._tracks]
        owner = owners(self._held, np.array(sure, np.bool_), points.feature_id)
        return replace(points, track_id=ids_of(self._tracks)[owner])

    def hidden_features(self, frame: FrameViews) -> HiddenFeatures:
        """Those of bodies that were seen to move and are out of sight."""
        return hidden_features(self._tracks, frame)

    def hidden_places(self, frame: FrameViews) -> FloatArray:
        """Where those bodies may come into sight (K, 3), in the left camera."""
        return hidden_places(self._tracks, frame)

    def predicted_velocities(self, motions: FeatureMotions) -> tuple[IntArray, FloatArray]:
        """Features of this frame (K,) that move on with a track, and its velocity (K, 3), world."""
        return velocities_of_members(self._held, self._hulls, motions)


def _has_left(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Does a track coast outside the image, its position hardly known any more? It is found again
    only by a measurement that would confirm a new track."""
    if track.state != TrackState.COASTING or is_in_view(track, T_world_cam0, rig):
        return False
    return horizontal_variance(track) > _LOST_M**2


def _is_alive(track: Track, now_ns: int, settings: ObjectTrackSettings) -> bool:
    """A tentative track lives until it is found to rest; all live on unseen for a while."""
    if rests(track, settings):
        return False
    unseen_s = 1e-9 * (now_ns - track.updated_ns)
    if track.state == TrackState.TENTATIVE:
        return unseen_s <= _TENTATIVE_UNSEEN_S
    return unseen_s <= settings.coast_s
