"""Which features lie where a track is."""

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.track import Track

_MARGIN_M = 0.5  # beyond the points seen so far: a body is larger than what was seen of it
_SIGMAS = 2.0  # of the feature's and the track's position


def inside(track: Track, p_world: FloatArray, position_cov: FloatArray) -> BoolArray:
    """Which points (N, 3), with covariance (N, 3, 3), may lie in a track's box, or near it."""
    c, s = np.cos(track.yaw), np.sin(track.yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    beyond = np.abs((p_world - track.position) @ R) - 0.5 * track.size
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    variance = np.trace(position_cov, axis1=1, axis2=2)
    variance = variance + np.trace(track.filter.best.covariance[:2, :2])
    with np.errstate(invalid="ignore"):
        near: BoolArray = outside < _MARGIN_M + _SIGMAS * np.sqrt(variance)
    return near
