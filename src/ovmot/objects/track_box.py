"""The box of a track in the image."""

from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.boxes import box_corners
from ovmot.objects.track import Track


def is_in_view(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Is a track's centre in the left image?"""
    p_cam0 = se3.apply(se3.inverse(T_world_cam0), track.position[None])
    return bool(rig.cam0.inside(rig.cam0.project(p_cam0))[0])


def are_whole(tracks: Sequence[Track], T_world_cam0: FloatArray, rig: StereoRig) -> list[bool]:
    """Of each track: are all corners of its box in the left image, and is no nearer track's box
    before it?"""
    p_cam0 = se3.apply(
        se3.inverse(T_world_cam0), np.concatenate([_corners(track) for track in tracks])
    )
    uv = rig.cam0.project(p_cam0)
    inside = rig.cam0.inside(uv).reshape(-1, 8).all(axis=1)
    lo, hi = uv.reshape(-1, 8, 2).min(axis=1), uv.reshape(-1, 8, 2).max(axis=1)  # NaN: behind
    depth = p_cam0[:, 2].reshape(-1, 8).mean(axis=1)
    overlap = ((lo[:, None] < hi[None]) & (lo[None] < hi[:, None])).all(axis=2)
    hidden = (overlap & (depth[None] < depth[:, None])).any(axis=1)
    whole: list[bool] = (inside & ~hidden).tolist()
    return whole


def _corners(track: Track) -> FloatArray:
    """The corners (8, 3) of a track's box, world."""
    return box_corners(track.position, track.size, track.yaw)


def projected_box(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """Left-image box (4,) of a track's 3-D box, clipped at the image border: least u, v, greatest
    u, v, pixels; NaN where its centre is outside the image."""
    if not is_in_view(track, T_world_cam0, rig):
        return np.full(4, np.nan)
    uv = rig.cam0.project(se3.apply(se3.inverse(T_world_cam0), _corners(track)))
    edge = np.array([rig.cam0.width, rig.cam0.height]) - 0.5
    uv = np.clip(uv, -0.5, edge)  # and NaN where a corner is behind the camera
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])
