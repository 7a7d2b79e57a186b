"""Which features lie where a track is, and whether that is in the picture."""

from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.track import Track

_MARGIN_M = 0.5  # beyond the points seen so far: a body is larger than what was seen of it
_SIGMAS = 2.0  # of the feature's and the track's position


def inside(tracks: Sequence[Track], p_world: FloatArray, position_cov: FloatArray) -> BoolArray:
    """Which points (N, 3), with covariance (N, 3, 3), may lie in tracks' boxes, or near: (T, N)."""
    if not tracks:
        return np.zeros((0, len(p_world)), dtype=np.bool_)
    position, size = np.array([t.position for t in tracks]), np.array([t.size for t in tracks])
    yaw = np.array([t.yaw for t in tracks])
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y, z = (p_world[:, k] - position[:, k, None] for k in range(3))
    half = 0.5 * size[:, :, None]
    along = np.maximum(np.abs(c * x + s * y) - half[:, 0], 0.0)
    across = np.maximum(np.abs(c * y - s * x) - half[:, 1], 0.0)
    above = np.maximum(np.abs(z) - half[:, 2], 0.0)
    of_tracks = np.array([np.trace(t.filter.best.covariance[:2, :2]) for t in tracks])
    variance = np.trace(position_cov, axis1=1, axis2=2) + of_tracks[:, None]
    with np.errstate(invalid="ignore"):
        outside = np.sqrt(along**2 + across**2 + above**2)
        near: BoolArray = outside < _MARGIN_M + _SIGMAS * np.sqrt(variance)
    return near


def is_in_view(track: Track, T_world_cam0: FloatArray, rig: StereoRig) -> bool:
    """Is a track's middle in the left picture?"""
    place = se3.apply(se3.inverse(T_world_cam0), track.position[None])
    return bool(rig.cam0.inside(rig.cam0.project(place))[0])
