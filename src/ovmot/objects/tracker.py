"""Tracks of moving bodies over time: ids that stay, through stops and occlusions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained, union, without
from ovmot.objects.association import associate, shared_share
from ovmot.objects.feature_motions import (
    FeatureMotions,
    Sightings,
    UnmeasuredBody,
    body_of,
    follow,
    join,
)
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.merging import BESIDE_NS, merged
from ovmot.objects.monocular_points import placed_by_tracks
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.object_filter import distance, observe, update
from ovmot.objects.output import to_object_track
from ovmot.objects.point_labels import label_points, speeds_of
from ovmot.objects.region import inside, is_in_view
from ovmot.objects.track import (
    Track,
    TrackState,
    carried,
    gaps,
    is_sure,
    measured,
    place_variance,
    start_track,
)
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, ScenePoints

_FOLLOWED_GATE = 25.0  # beyond: the features have stayed behind on something else
_TENTATIVE_MISSES_S = 0.25
_MAX_ACCEL, _SIGMAS = 8.0, 3.0  # m/s²: a car on its brakes
_LOST_M = 1.0  # standard deviation of its place
_MIN_FOUND = 2  # features that go as a track should, where it should be, are the track


class ObjectTracker:
    """Keeps the tracks, and the next id: ids are never used again."""

    def __init__(self, rig: StereoRig, settings: ObjectTrackSettings) -> None:
        self._rig = rig
        self._settings = settings
        self._tracks: tuple[Track, ...] = ()
        self._sightings = Sightings()
        self._next_id = 0
        self._last_ns = 0
        self._speeds = speeds_of(0, ())

    def step(
        self,
        timestamp_ns: int,
        measurements: Sequence[ObjectMeasurement],
        seen: ScenePoints,
        T_world_cam0: FloatArray,
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        """The tracks of this frame, and its points with their tracks' ids.

        A point that nothing else was known of moves where its track does.
        """
        settings = self._settings
        # 1 where every track should be now, and how each feature has moved
        tracks = [carried(track, timestamp_ns, settings) for track in self._tracks]
        motions = self._motions(timestamp_ns, seen, tracks, T_world_cam0)
        # 2 which measurement is whose
        left = np.array([_has_left(t, T_world_cam0, self._rig) for t in tracks], dtype=np.bool_)
        pairs = _pairs(tracks, measurements, left, timestamp_ns)
        taken = {j for _, j in pairs}
        own = dict(pairs)
        # 3 correct: by the measurement, else by the features that go as the track should
        asked = tracks if len(own) < len(tracks) else []
        near = inside(asked, motions.p_world, motions.position_cov)
        free = _free(asked, near, _owner(asked, seen.feature_id))
        for i, track in enumerate(tracks):
            tracks[i] = (
                measured(track, measurements[own[i]], timestamp_ns, settings)
                if i in own
                else _followed(track, motions, near[i], free[i], timestamp_ns)
            )
        # 4 new ones
        for j, measurement in enumerate(measurements):
            if j not in taken:
                tracks.append(start_track(self._next_id, timestamp_ns, measurement))
                self._next_id += 1
        # 5 features that joined, two tracks on one body, and those that are gone
        alive = [track for track in tracks if _lives(track, timestamp_ns, settings)]
        owner = _owner(alive, seen.feature_id)
        near = inside(alive, motions.p_world, motions.position_cov)
        alive = [_joined(t, motions, owner, at) for t, at in zip(alive, near, strict=True)]
        self._tracks = merged(_with_own_features(alive, seen), settings)
        owner = _owner(self._tracks, seen.feature_id)
        shown = tuple(
            to_object_track(t, timestamp_ns, seen, owner, T_world_cam0, self._rig, settings)
            for t in self._tracks
        )
        before, self._speeds = self._speeds, speeds_of(timestamp_ns, self._tracks)
        points = label_points(timestamp_ns, seen, owner, self._tracks, motions, before)
        return shown, points

    def _motions(
        self, now_ns: int, seen: ScenePoints, tracks: Sequence[Track], T_world_cam0: FloatArray
    ) -> FeatureMotions:
        """Of the features of this frame; for those of tracks the left camera is enough."""
        since_s, self._last_ns = 1e-9 * (now_ns - self._last_ns), now_ns
        before = self._sightings.last
        placed = placed_by_tracks(seen, tracks, before, since_s, T_world_cam0, self._rig)
        return self._sightings.add(now_ns, placed, T_world_cam0)

    def owned(self, seen: ScenePoints) -> ScenePoints:
        """The points of a new frame with the tracks that their features had until now.

        Only tracks that are sure of their body: a piece of one shall find its whole again.
        """
        sure = [t for t in self._tracks if t.state == TrackState.CONFIRMED and t.overlaps == 0]
        return replace(seen, track_id=_owner(sure, seen.feature_id))

    def expected(self, seen: ScenePoints) -> tuple[IntArray, FloatArray]:
        """Features of this frame (N,) that should go on with a track, and its velocity (N, 3)."""
        velocity = np.full((len(seen.feature_id), 3), np.nan)
        motions = self._sightings.last
        near = inside(self._tracks, motions.p_world, motions.position_cov) & ~motions.known
        for track, at in zip(self._tracks, near, strict=True):
            own = contained(motions.feature_id, track.feature_id)
            velocity[own | at] = track.velocity
        known = np.isfinite(velocity[:, 0])
        return seen.feature_id[known], velocity[known]


def _free(tracks: Sequence[Track], near: BoolArray, owner: IntArray) -> BoolArray:
    """Features (T, N) at which each track may be found again: `near` it (T, N), no other track's,
    and not where another body is that was seen beside it."""
    in_view = np.array([t.state == TrackState.CONFIRMED for t in tracks], dtype=np.bool_)
    born = np.array([t.born_ns for t in tracks], dtype=np.int64)
    updated = np.array([t.updated_ns for t in tracks], dtype=np.int64)
    beside = in_view & (born + BESIDE_NS < updated[:, None])
    np.fill_diagonal(beside, False)
    track_id = np.array([t.track_id for t in tracks], dtype=np.int64)
    free: BoolArray = near & ~(beside @ near) & ((owner < 0) | (owner == track_id[:, None]))
    return free


def _followed(
    track: Track, motions: FeatureMotions, near: BoolArray, free: BoolArray, now_ns: int
) -> Track:
    """The track by its features, without a measurement; coasting where they are lost.

    `near` (N,): features where it should be; `free` (N,): those at which it may be found again.
    """
    if track.state == TrackState.TENTATIVE:
        return _unseen(track)
    own = near & contained(motions.feature_id, track.feature_id)
    for body in (follow(motions, own, track.velocity), _found_again(track, motions, free)):
        if body is None or not _could_do(track, body, now_ns):
            continue
        observation = observe(body.position - track.offset, body.velocity, _loose(body, track))
        if distance(track.filter, observation) > _FOLLOWED_GATE:
            continue
        corrected = update(track.filter, observation)
        return replace(
            track,
            state=TrackState.CONFIRMED,
            filter=corrected,
            offset=body.position - corrected.best.state[:3],
            feature_id=without(track.feature_id, body.strayed),
            updated_ns=now_ns,
        )
    return _unseen(track)


def _could_do(track: Track, body: UnmeasuredBody, now_ns: int) -> bool:
    """Can a track have come to this velocity since it was seen? Else its features are the street's,
    left behind: also where rest explains them better than braking as hard as can be."""
    most = _MAX_ACCEL * 1e-9 * (now_ns - track.updated_ns)
    C = body.covariance[3:, 3:]
    change = body.velocity - track.velocity
    size = max(float(np.linalg.norm(change)), 1e-9)
    sigma = float(np.sqrt(change @ C @ change)) / size
    speed = float(np.linalg.norm(track.velocity))
    braked = track.velocity * max(1.0 - most / max(speed, 1e-9), 0.0)
    off = np.stack([body.velocity - braked, body.velocity])
    from_braked, from_rest = (off * np.linalg.solve(C, off.T).T).sum(1)
    return bool(size < most + _SIGMAS * sigma and from_braked <= from_rest)


def _found_again(track: Track, motions: FeatureMotions, free: BoolArray) -> UnmeasuredBody | None:
    """The body by any `free` features that go as it should; None with less than two."""
    joins = _joining(track, motions, free)
    return body_of(motions, joins) if joins.sum() >= _MIN_FOUND else None


def _joined(track: Track, motions: FeatureMotions, owner: IntArray, near: BoolArray) -> Track:
    """The track with the features in its box that go as it goes, and without those far off it.

    `near` (N,): which features are in its box.
    """
    if track.state == TrackState.COASTING:
        return track
    ids = track.feature_id
    if track.state == TrackState.CONFIRMED:
        free = near & ((owner < 0) | (owner == track.track_id))
        ids = union(ids, motions.feature_id[_joining(track, motions, free)])
    return replace(track, feature_id=without(ids, motions.feature_id[~near & _placed(motions)]))


def _placed(motions: FeatureMotions) -> BoolArray:
    """Which features (N,) have a position."""
    return np.asarray(np.isfinite(motions.p_world[:, 0]))


def _joining(track: Track, motions: FeatureMotions, free: BoolArray) -> BoolArray:
    """Those of the `free` features (N,) that go as a track goes, and do not rest."""
    return join(motions, free, track.velocity, track.filter.best.covariance[VELOCITY, VELOCITY])


def _unseen(track: Track) -> Track:
    """A tentative track must be measured in consecutive frames: it begins again."""
    if track.state == TrackState.TENTATIVE:
        return replace(track, hits=0, evidence=0.0)
    return replace(track, state=TrackState.COASTING)


def _loose(body: UnmeasuredBody, track: Track) -> FloatArray:
    """The covariance (6, 6), for a middle that slides over the body as other parts are seen."""
    P = body.covariance.copy()
    P[:3, :3] += (0.25 * float(track.size.max())) ** 2 * np.eye(3)
    return P


def _pairs(
    tracks: Sequence[Track],
    measurements: Sequence[ObjectMeasurement],
    left: BoolArray,
    now_ns: int,
) -> list[tuple[int, int]]:
    """Tracks and their measurements; `left` (T,): which tracks have left the picture."""
    if not tracks or not measurements:
        return []
    d = gaps(tracks, measurements, now_ns)
    share, count = shared_share(
        [t.feature_id for t in tracks], [m.feature_id for m in measurements]
    )
    # what is made of another track's features is no part of this one
    most = 0.5 * np.array([len(m.feature_id) for m in measurements])
    d[(count == 0) & (count.max(0) > most)] = np.inf
    # one that has left the picture is not found again by less than begins a track
    if left.any():
        unsure = ~np.array([is_sure(m) for m in measurements])
        d[left[:, None] & unsure & (count == 0)] = np.inf
    return associate(d, share, count)


def _has_left(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Is a track not seen, and its place outside the picture and hardly known any more?"""
    if track.state != TrackState.COASTING or is_in_view(track, T_world_cam0, rig):
        return False
    return place_variance(track) > _LOST_M**2


def _lives(track: Track, now_ns: int, settings: ObjectTrackSettings) -> bool:
    """Tentative tracks live on measurements; the others until nothing was seen for a while."""
    unseen_s = 1e-9 * (now_ns - track.updated_ns)
    if track.state == TrackState.TENTATIVE:
        return unseen_s <= _TENTATIVE_MISSES_S
    return unseen_s <= settings.coast_s


def _with_own_features(tracks: Sequence[Track], seen: ScenePoints) -> list[Track]:
    """Features that are no longer seen leave; of two tracks the older one keeps a common one."""
    out, taken, in_view = [], np.empty(0, dtype=np.int64), np.sort(seen.feature_id)
    for track in tracks:
        kept = contained(track.feature_id, in_view) & ~contained(track.feature_id, taken)
        lost = track.state == TrackState.COASTING
        ids = track.feature_id if lost else track.feature_id[kept]
        taken = union(taken, ids)
        out.append(replace(track, feature_id=ids))
    return out


def _owner(tracks: Sequence[Track], feature_id: IntArray) -> IntArray:
    owner = np.full(len(feature_id), -1, dtype=np.int64)
    for track in tracks:
        if track.state != TrackState.COASTING:
            owner[contained(feature_id, track.feature_id)] = track.track_id
    return owner
