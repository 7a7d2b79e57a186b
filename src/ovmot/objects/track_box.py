"""The box of a track in the image."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.track import Track


def is_in_view(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Is a track's centre in the left image?"""
    p_cam0 = se3.apply(se3.inverse(T_world_cam0), track.position[None])
    return bool(rig.cam0.inside(rig.cam0.project(p_cam0))[0])


def projected_box(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """Left-image box (4,) of a track's 3-D box, clipped at the image border: least u, v, greatest
    u, v, pixels; NaN where its centre is outside the image."""
    if not is_in_view(track, T_world_cam0, rig):
        return np.full(4, np.nan)
    half = 0.5 * track.size
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = track.position + (signs * half) @ so3.rotation_z(track.yaw).T
    uv = rig.cam0.project(se3.apply(se3.inverse(T_world_cam0), corners))
    edge = np.array([rig.cam0.width, rig.cam0.height]) - 0.5
    uv = np.clip(uv, -0.5, edge)  # and NaN where a corner is behind the camera
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
