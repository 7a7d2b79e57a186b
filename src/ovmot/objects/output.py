"""Output conversion: a track as the frame's result has it."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body_box_kernel import Box
from ovmot.objects.track import Track, TrackState, horizontal_variance
from ovmot.objects.track_box import image_box, is_in_view
from ovmot.types import ObjectTrack

_MISSED_S = 0.15  # missed for no longer than this, a confirmed track is still called confirmed
_KNOWN_S, _KNOWN_SIGMA_M = 0.5, 0.5  # and for longer while its place in view is known to this


def to_object_track(
    track: Track,
    now_ns: int,
    uv: FloatArray,
    T_world_cam0: FloatArray,
    rig: StereoRig,
) -> ObjectTrack:
    """A track's state, box and standard deviations; `uv` (n, 2): its points in the left image.

    World axes, SI; the image box in left pixels.
    """
    variance = np.maximum(np.diag(track.covariance), 0.0)
    return ObjectTrack(
        track_id=track.track_id,
        state=_output_state(track, now_ns, T_world_cam0, rig).value,
        position=track.position,
        velocity=track.velocity,
        yaw=track.yaw,
        yaw_rate=float(track.body.state.x[7]),
        size=track.size,
        box_px=image_box(track, uv, T_world_cam0, rig),
        n_points=len(uv),
        std_position=np.sqrt(variance[:3] + _centre_variance(track.box)),
        std_velocity=np.sqrt(variance[3:6]),
        std_size=track.box.std_size,
        std_yaw=float(np.sqrt(track.heading.variance)),
        std_yaw_rate=float(np.sqrt(track.body.state.P[7, 7])),
    )


def _centre_variance(box: Box) -> FloatArray:
    """Variances (3,) of a box's centre, in world: the face that was seen stays, so the centre is
    off by half of what the size is."""
    R = rotation_z(box.yaw)
    return np.asarray(R**2 @ (0.5 * box.std_size) ** 2)


def _output_state(
    track: Track,
    now_ns: int,
    T_world_cam0: FloatArray,
    rig: StereoRig,
) -> TrackState:
    """The state to report: a missed track stays confirmed for a short time, and longer while its
    position in view is well known, as behind something."""
    if track.state != TrackState.COASTING:
        return track.state
    missed_s = 1e-9 * (now_ns - track.updated_ns)
    known = missed_s <= _KNOWN_S and horizontal_variance(track) < _KNOWN_SIGMA_M**2
    occluded = known and is_in_view(track, T_world_cam0, rig)
    return TrackState.CONFIRMED if missed_s <= _MISSED_S or occluded else track.state
