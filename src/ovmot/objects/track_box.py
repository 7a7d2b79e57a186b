"""The box of a track: which features lie in it, its box in the image, its distance to others."""

from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.features_kernel import points_near_boxes_compiled
from ovmot.objects.track import Track, horizontal_variance

_MARGIN_M = 0.5  # beyond the points seen so far: a body is larger than what was seen of it
_SIGMAS = 2.0  # of the feature's and the track's position


def points_in_boxes(
    tracks: Sequence[Track], p_world: FloatArray, position_cov: FloatArray
) -> BoolArray:
    """Which points (N, 3), with covariance (N, 3, 3), may lie in or near tracks' boxes: (T, N)."""
    if not tracks:
        return np.zeros((0, len(p_world)), dtype=np.bool_)
    return points_near_boxes_compiled(
        p_world,
        position_cov,
        np.array([t.box.hull_centre for t in tracks]),
        np.array([t.box.hull_size for t in tracks]),
        np.array([t.yaw for t in tracks]),
        np.array([2.0 * horizontal_variance(t) for t in tracks]),
        _MARGIN_M,
        _SIGMAS,
    )


def is_in_view(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Is a track's centre in the left image?"""
    p_cam0 = se3.apply(se3.inverse(T_world_cam0), track.position[None])
    return bool(rig.cam0.inside(rig.cam0.project(p_cam0))[0])


def image_box(track: Track, uv: FloatArray, T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """Left-image box (4,) of a track's points `uv` (N, 2): least u, v, greatest u, v, pixels.

    With fewer than two points that of its 3-D box, clipped at the image border; NaN where its
    centre is outside the image.
    """
    if len(uv) >= 2:
        return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    if not is_in_view(track, T_world_cam0, rig):
        return np.full(4, np.nan)
    half = 0.5 * track.size
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = track.position + (signs * half) @ so3.rotation_z(track.yaw).T
    uv = rig.cam0.project(se3.apply(se3.inverse(T_world_cam0), corners))
    edge = np.array([rig.cam0.width, rig.cam0.height]) - 0.5
    uv = np.clip(uv, -0.5, edge)  # and NaN where a corner is behind the camera
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
