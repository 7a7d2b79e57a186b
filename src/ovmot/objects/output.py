"""Output conversion: tracks as the frame's result has them."""

import math
from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.body_box_kernel import Box
from ovmot.objects.track import Track, TrackState, horizontal_variance
from ovmot.objects.track_box import is_in_view, projected_box
from ovmot.objects.track_features_kernel import spans_of_compiled
from ovmot.types import ObjectTrack

_MISSED_S = 0.15  # missed for no longer than this, a confirmed track is still called confirmed
_KNOWN_S, _KNOWN_SIGMA_M = 0.5, 0.5  # and for longer while its place in view is known to this


def to_object_tracks(
    tracks: Sequence[Track],
    now_ns: int,
    pixels: FloatArray,
    owner: IntArray,
    T_world_cam0: FloatArray,
    rig: StereoRig,
) -> tuple[ObjectTrack, ...]:
    """Tracks' states, boxes and standard deviations; world axes, SI, image boxes in left pixels.

    `pixels` (N, 4) of the frame's features, the left ones first, and the row `owner` (N,) of the
    track that holds each of them; -1 for none.
    """
    boxes, n_points = spans_of_compiled(owner, pixels, len(tracks))
    return tuple(
        ObjectTrack(
            track_id=track.track_id,
            state=_output_state(track, now_ns, T_world_cam0, rig).value,
            position=track.position,
            velocity=track.velocity,
            yaw=track.yaw,
            yaw_rate=float(track.body.state.x[7]),
            size=track.size,
            box_px=box if n > 1 else projected_box(track, T_world_cam0, rig),
            n_points=n,
            std_position=sigma[:3],
            std_velocity=sigma[3:],
            std_size=track.box.std_size,
            std_yaw=math.sqrt(track.heading.variance),
            std_yaw_rate=math.sqrt(track.body.state.P[7, 7]),
        )
        for track, box, n, sigma in zip(
            tracks, boxes, n_points.tolist(), _sigmas([t.box for t in tracks]), strict=True
        )
    )


def _sigmas(boxes: Sequence[Box]) -> FloatArray:
    """Standard deviations (T, 6) of boxes' centres and velocities, in world.

    The face that was seen stays: the centre is off by half of what the size is.
    """
    variance = np.array([box.covariance.diagonal() for box in boxes]).reshape(-1, 6)
    half = np.square(0.5 * np.array([box.std_size for box in boxes])).reshape(-1, 3)
    along = np.square(np.cos([box.yaw for box in boxes]))
    np.maximum(variance, 0.0, out=variance)
    variance[:, 0] += along * half[:, 0] + (1.0 - along) * half[:, 1]
    variance[:, 1] += (1.0 - along) * half[:, 0] + along * half[:, 1]
    variance[:, 2] += half[:, 2]
    return np.asarray(np.sqrt(variance))


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
