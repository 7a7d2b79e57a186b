"""Output conversion: tracks as the frame's result has them."""

import math
from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.reported_place import centre_sigma
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
            position=track.position + track.lag,
            velocity=track.velocity,
            yaw=track.yaw,
            yaw_rate=float(track.body.state.x[7]),
            size=track.size,
            box_px=box if n > 1 else projected_box(track, T_world_cam0, rig),
            n_points=n,
            std_position=sigma[0],
            std_velocity=sigma[1],
            std_size=track.box.std_size,
            std_yaw=math.sqrt(track.heading.variance),
            std_yaw_rate=math.sqrt(track.body.state.P[7, 7]),
            class_probability=track.class_probability,
        )
        for track, box, n, sigma in zip(
            tracks, boxes, n_points.tolist(), map(_sigmas, tracks), strict=True
        )
    )


def _sigmas(track: Track) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (3,) of a track's reported centre, and of its velocity, in world."""
    place = np.sqrt(np.square(centre_sigma(track.box)) + np.square(track.lag))
    return place, np.sqrt(np.maximum(track.velocity_cov.diagonal(), 0.0))


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
