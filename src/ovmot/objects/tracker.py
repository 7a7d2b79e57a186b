"""Tracks of moving bodies over time: ids that stay, through stops and occlusions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import ObjectTrackSettings
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.association import associate, shared_share
from ovmot.objects.followed import FeatureMotions, FollowedBody, Sightings, body_of, follow, join
from ovmot.objects.id_sets import contained, union, without
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.motion_models import VELOCITY, YAW_RATE
from ovmot.objects.object_filter import distance, observe, update
from ovmot.objects.point_labels import label_points, speeds_of
from ovmot.objects.region import inside
from ovmot.objects.track import DRIVES_MPS, Track, TrackState, carried, gaps, measured, start_track
from ovmot.types import ObjectTrack, ScenePoints

_FOLLOWED_GATE = 25.0  # beyond: the features have stayed behind on something else
_TENTATIVE_MISSES_S = 0.25
_SAME_SPEED_MPS, _SPEED_SPREAD = 1.5, 0.3
_ALIKE_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_MAX_ACCEL, _SIGMAS = 8.0, 3.0  # m/s²: a car on its brakes
_MIN_FOUND = 3  # features that go as a track should, where it should be, are the track
_LENGTH_M, _HALF_WIDTH_M = 4.0, 1.0  # nearer than this, two middles are of one vehicle
_FEW_OF_MANY = 0.1
_GAP_M = 2.5  # without features, between two ends of a lorry
_BODY_WIDTH_M = 3.2  # boxes of few points are too wide
_WIDTH_M = 2.0  # within a box that is wider, there may be two bodies


class ObjectTracker:
    """Keeps the tracks, and the next id: ids are never used again."""

    def __init__(self, rig: StereoRig, settings: ObjectTrackSettings) -> None:
        self._rig = rig
        self._settings = settings
        self._tracks: tuple[Track, ...] = ()
        self._sightings = Sightings()
        self._next_id = 0
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
        motions = self._sightings.add(timestamp_ns, seen, T_world_cam0)
        # 1 where every track should be now
        tracks = [carried(track, timestamp_ns, settings) for track in self._tracks]
        # 2 which measurement is whose
        pairs = _pairs(tracks, measurements, timestamp_ns)
        taken = {j for _, j in pairs}
        own = dict(pairs)
        # 3 correct: by the measurement, else by the features that go as the track should
        owner = _owner(tracks, seen.feature_id)
        for i, track in enumerate(tracks):
            tracks[i] = (
                measured(track, measurements[own[i]], timestamp_ns, settings)
                if i in own
                else _followed(track, motions, owner, timestamp_ns)
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
        self._tracks = _merged(_with_own_features(alive, seen), settings)
        owner = _owner(self._tracks, seen.feature_id)
        shown = tuple(
            _as_result(t, timestamp_ns, seen, owner, T_world_cam0, self._rig, settings)
            for t in self._tracks
        )
        before, self._speeds = self._speeds, speeds_of(timestamp_ns, self._tracks)
        points = label_points(timestamp_ns, seen, owner, self._tracks, motions, before)
        return shown, points

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


def _followed(track: Track, motions: FeatureMotions, owner: IntArray, now_ns: int) -> Track:
    """The track by its features, without a measurement; coasting where they are lost."""
    if track.state == TrackState.TENTATIVE:
        return _unseen(track)
    own = contained(motions.feature_id, track.feature_id)
    for body in (follow(motions, own, track.velocity), _found_again(track, motions, owner)):
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


def _could_do(track: Track, body: FollowedBody, now_ns: int) -> bool:
    """Can a track have come to this velocity since it was seen? Else its features are the street's,
    left behind."""
    change = float(np.linalg.norm(body.velocity - track.velocity))
    sigma = np.sqrt(np.trace(body.covariance[3:, 3:]))
    return bool(change < _MAX_ACCEL * 1e-9 * (now_ns - track.updated_ns) + _SIGMAS * sigma)


def _found_again(track: Track, motions: FeatureMotions, owner: IntArray) -> FollowedBody | None:
    """The body by any features where it should be that go as it should; None with less than two."""
    near = inside([track], motions.p_world, motions.position_cov)[0]
    joins = _joining(track, motions, owner, near)
    return body_of(motions, joins) if joins.sum() >= _MIN_FOUND else None


def _joined(track: Track, motions: FeatureMotions, owner: IntArray, near: BoolArray) -> Track:
    """The track with the features in its box that go as it goes, and without those far off it.

    `near` (N,): which features are in its box.
    """
    if track.state == TrackState.COASTING:
        return track
    ids = track.feature_id
    if track.state == TrackState.CONFIRMED:
        ids = union(ids, motions.feature_id[_joining(track, motions, owner, near)])
    return replace(track, feature_id=without(ids, motions.feature_id[~near & _placed(motions)]))


def _placed(motions: FeatureMotions) -> BoolArray:
    """Which features (N,) have a position."""
    return np.asarray(np.isfinite(motions.p_world[:, 0]))


def _joining(track: Track, motions: FeatureMotions, owner: IntArray, near: BoolArray) -> BoolArray:
    """Features (N,) `near` a track that go as it goes, do not rest and are no other track's."""
    free = near & ((owner < 0) | (owner == track.track_id))
    return join(motions, free, track.velocity, track.filter.best.covariance[VELOCITY, VELOCITY])


def _unseen(track: Track) -> Track:
    """A tentative track must be measured in consecutive frames: it begins again."""
    if track.state == TrackState.TENTATIVE:
        return replace(track, hits=0, evidence=0.0)
    return replace(track, state=TrackState.COASTING)


def _loose(body: FollowedBody, track: Track) -> FloatArray:
    """The covariance (6, 6), for a middle that slides over the body as other parts are seen."""
    P = body.covariance.copy()
    P[:3, :3] += (0.25 * float(track.size.max())) ** 2 * np.eye(3)
    return P


def _pairs(
    tracks: Sequence[Track], measurements: Sequence[ObjectMeasurement], now_ns: int
) -> list[tuple[int, int]]:
    if not tracks or not measurements:
        return []
    d = gaps(tracks, measurements, now_ns)
    share, count = shared_share(
        [t.feature_id for t in tracks], [m.feature_id for m in measurements]
    )
    return associate(d, share, count)


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


def _merged(tracks: Sequence[Track], settings: ObjectTrackSettings) -> tuple[Track, ...]:
    """Tracks that have lain on an older one for some frames become one with it.

    The older one's id stays, with what the one of more features knows. Until then a new one that
    lies on an older one is not believed.
    """
    out: list[Track] = []
    for track in tracks:
        over = next((k for k, other in enumerate(out) if _same_body(track, other)), None)
        if over is None:
            out.append(replace(track, overlaps=max(track.overlaps - 1, 0)))
        elif track.overlaps + 1 < settings.merge_frames:
            young = track.hits <= settings.confirm_hits + settings.merge_frames
            state = TrackState.TENTATIVE if young else track.state
            out.append(replace(track, state=state, overlaps=track.overlaps + 1))
        else:
            out[over] = _united(out[over], track)
    return tuple(out)


def _united(track: Track, other: Track) -> Track:
    """A track and a younger one of the same body: as the one of more features knows it."""
    ids = np.union1d(track.feature_id, other.feature_id)
    known = track if len(track.feature_id) >= len(other.feature_id) else other
    return replace(known, track_id=track.track_id, feature_id=ids, overlaps=0)


def _same_body(track: Track, other: Track) -> bool:
    """Is one in the other, where no second body can be, or do they overlap and move alike?"""
    if TrackState.COASTING not in (track.state, other.state) and (
        _is_within(track, other) or _is_within(other, track)
    ):
        return True
    along, across = _apart(track, other)
    reach = 0.5 * (other.size + np.minimum(track.size, other.size))
    near = along < max(reach[0], 1.0) and across < max(0.7 * reach[1], 0.7)
    drive = min(np.linalg.norm(track.velocity), np.linalg.norm(other.velocity)) > DRIVES_MPS
    near |= drive and along < _LENGTH_M and across < _HALF_WIDTH_M  # two ends of a vehicle
    near |= drive and _is_piece(track, other, along, across)
    return bool(near and _goes_like(track, other))


def _goes_like(track: Track, other: Track) -> bool:
    """Are two velocities the same, within their covariance and by no more than a walker's speed?"""
    dv = track.velocity - other.velocity
    P = sum(t.filter.best.covariance[VELOCITY, VELOCITY] for t in (track, other))
    C = P + _SPEED_SPREAD**2 * np.eye(3)
    alike = dv @ np.linalg.solve(C, dv) < _ALIKE_GATE
    return bool(alike and np.linalg.norm(dv) < _SAME_SPEED_MPS)


def _is_piece(track: Track, other: Track, along: float, across: float) -> bool:
    """Can a track of few features be the far end of one that has many?"""
    few = len(track.feature_id) < _FEW_OF_MANY * len(other.feature_id)
    gap = along - 0.5 * (track.size[0] + other.size[0])
    width = across + 0.5 * (track.size[1] + other.size[1])
    return bool(few and gap < _GAP_M and width < _BODY_WIDTH_M)


def _is_within(track: Track, other: Track) -> bool:
    """Is a track's middle inside the box of another one with more features?"""
    along, across = _apart(track, other)
    inner = along < 0.5 * other.size[0] and across < 0.5 * min(other.size[1], _WIDTH_M)
    return bool(inner and len(track.feature_id) < len(other.feature_id))


def _apart(track: Track, other: Track) -> tuple[float, float]:
    """Distances of the middles, along and across the other's heading, metres."""
    apart = track.position - other.position
    c, s = np.cos(other.yaw), np.sin(other.yaw)
    return abs(c * apart[0] + s * apart[1]), abs(-s * apart[0] + c * apart[1])


def _owner(tracks: Sequence[Track], feature_id: IntArray) -> IntArray:
    owner = np.full(len(feature_id), -1, dtype=np.int64)
    for track in tracks:
        if track.state != TrackState.COASTING:
            owner[contained(feature_id, track.feature_id)] = track.track_id
    return owner


def _as_result(
    track: Track,
    now_ns: int,
    seen: ScenePoints,
    owner: IntArray,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectTrackSettings,
) -> ObjectTrack:
    best = track.filter.best
    sigma = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    own = owner == track.track_id
    return ObjectTrack(
        track_id=track.track_id,
        state=_shown_state(track, now_ns, settings).value,
        position=track.position,
        velocity=track.velocity,
        yaw=track.yaw,
        yaw_rate=float(best.state[YAW_RATE]),
        size=track.size,
        box_px=_box(track, seen.pixels[own, :2], T_world_cam0, rig),
        n_points=int(own.sum()),
        std_position=sigma[:3],
        std_velocity=sigma[3:6],
    )


def _shown_state(track: Track, now_ns: int, settings: ObjectTrackSettings) -> TrackState:
    """A confirmed track that was missed for a frame or two is not yet called coasting."""
    missed_s = 1e-9 * (now_ns - track.updated_ns)
    if track.state == TrackState.COASTING and missed_s <= settings.missed_s:
        return TrackState.CONFIRMED
    return track.state


def _box(track: Track, uv: FloatArray, T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """Left-image box (4,) of its points; of its 3-D box where it has fewer than two; else NaN."""
    if len(uv) < 2:
        half = 0.5 * track.size
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        c, s = np.cos(track.yaw), np.sin(track.yaw)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        corners = track.position + (signs * half) @ R.T
        uv = rig.cam0.project(se3.apply(se3.inverse(T_world_cam0), corners))
        if not np.isfinite(uv).all():
            return np.full(4, np.nan)
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
