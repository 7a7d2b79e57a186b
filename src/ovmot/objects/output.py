"""What is told of a track to those outside: its state, its box in the picture, its sigmas."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.motion_models import YAW_RATE
from ovmot.objects.region import is_in_view
from ovmot.objects.track import Track, TrackState, place_variance
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, ScenePoints


def to_object_track(
    track: Track,
    now_ns: int,
    seen: ScenePoints,
    owner: IntArray,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectTrackSettings,
) -> ObjectTrack:
    """A track in the words of a frame's result; `owner` (N,) says whose the points `seen` are."""
    best = track.filter.best
    sigma = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    own = owner == track.track_id
    return ObjectTrack(
        track_id=track.track_id,
        state=_shown_state(track, now_ns, T_world_cam0, rig, settings).value,
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


def _shown_state(
    track: Track,
    now_ns: int,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectTrackSettings,
) -> TrackState:
    """A confirmed track that was missed is not yet called coasting while it is known where in the
    picture it is: behind something."""
    if track.state != TrackState.COASTING:
        return track.state
    missed_s = 1e-9 * (now_ns - track.updated_ns)
    known = place_variance(track) < settings.place_sigma_m**2
    there = known and is_in_view(track, T_world_cam0, rig)
    return TrackState.CONFIRMED if missed_s <= settings.missed_s or there else track.state


def _box(track: Track, uv: FloatArray, T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """Left-image box (4,) of its points; where it has fewer than two that of its 3-D box, as far as
    it is in the picture; NaN where its middle is outside."""
    if len(uv) >= 2:
        return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    if not is_in_view(track, T_world_cam0, rig):
        return np.full(4, np.nan)
    half = 0.5 * track.size
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    c, s = np.cos(track.yaw), np.sin(track.yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    corners = track.position + (signs * half) @ R.T
    uv = rig.cam0.project(se3.apply(se3.inverse(T_world_cam0), corners))
    edge = np.array([rig.cam0.width, rig.cam0.height]) - 0.5
    uv = np.clip(uv, -0.5, edge)  # and NaN where a corner is behind the camera
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
