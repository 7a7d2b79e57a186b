"""Output conversion: a track as the frame's result has it."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.motion_models import YAW_RATE
from ovmot.objects.track import Track, TrackState, horizontal_variance
from ovmot.objects.track_box import image_box, is_in_view
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, ScenePoints


def to_object_track(
    track: Track,
    now_ns: int,
    points: ScenePoints,
    track_id: IntArray,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectTrackSettings,
) -> ObjectTrack:
    """A track's state, box and standard deviations; `track_id` (N,): of the `points`, -1 for none.

    World axes, SI; the image box in left pixels.
    """
    best = track.filter.best
    sigma = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    own = track_id == track.track_id
    return ObjectTrack(
        track_id=track.track_id,
        state=_output_state(track, now_ns, T_world_cam0, rig, settings).value,
        position=track.position,
        velocity=track.velocity,
        yaw=track.yaw,
        yaw_rate=float(best.state[YAW_RATE]),
        size=track.size,
        box_px=image_box(track, points.pixels[own, :2], T_world_cam0, rig),
        n_points=int(own.sum()),
        std_position=sigma[:3],
        std_velocity=sigma[3:6],
    )


def _output_state(
    track: Track,
    now_ns: int,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectTrackSettings,
) -> TrackState:
    """The state to report: a missed track stays confirmed for a short time, and longer while its
    position in view is well known, as behind something."""
    if track.state != TrackState.COASTING:
        return track.state
    missed_s = 1e-9 * (now_ns - track.updated_ns)
    known = horizontal_variance(track) < settings.place_sigma_m**2
    occluded = known and is_in_view(track, T_world_cam0, rig)
    return TrackState.CONFIRMED if missed_s <= settings.missed_s or occluded else track.state
