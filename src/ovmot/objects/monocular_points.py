"""Monocular features of tracks: those that only the left camera sees get their track's depth.

A body that leaves the image, or goes behind another one, is lost to the right camera first. Its
features still measure its motion across the rays, and none along them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import contained, positions
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.track import Track, TrackState
from ovmot.types import ScenePoints

_PIXEL_SIGMA = 0.5
_DEPTH_SIGMA_M = 4.0  # so great that nothing is measured along the ray
_LEAST_DEPTH_M = 0.5
_ACROSS = 0.5  # of the velocity along the ray, that one across it must be at least


def with_track_depths(
    points: ScenePoints,
    tracks: Sequence[Track],
    before: FeatureMotions,
    since_s: float,
    T_world_cam0: FloatArray,
    rig: StereoRig,
) -> ScenePoints:
    """The points, those of confirmed `tracks` without a stereo match at their track's depth.

    `tracks` are predicted to now; `before`: the features' positions `since_s` ago.
    """
    monocular = ~np.isfinite(points.p_cam0[:, 2])
    last = _last_positions(before, points.feature_id)
    p_world = np.full((len(monocular), 3), np.nan)
    for track in tracks:
        if track.state != TrackState.TENTATIVE and _moves_across(track, T_world_cam0):
            own = monocular & contained(points.feature_id, track.feature_id)
            moved = last[own] + track.velocity * since_s
            p_world[own] = np.where(np.isfinite(moved), moved, track.position)
    depth = se3.apply(se3.inverse(T_world_cam0), p_world)[:, 2]
    index = np.flatnonzero(depth > _LEAST_DEPTH_M)
    depth, xy = depth[index], rig.cam0.normalize(points.pixels[index, :2])
    ray = np.column_stack([xy, np.ones(len(index))])
    across = (_PIXEL_SIGMA / rig.cam0.fx * depth) ** 2
    along = _DEPTH_SIGMA_M**2 * ray[:, :, None] * ray[:, None]
    p_cam0, cov_cam0 = points.p_cam0.copy(), points.cov_cam0.copy()
    p_cam0[index] = ray * depth[:, None]
    cov_cam0[index] = across[:, None, None] * np.eye(3) + along
    return replace(points, p_cam0=p_cam0, cov_cam0=cov_cam0)


def _moves_across(track: Track, T_world_cam0: FloatArray) -> bool:
    """Does a track move across its ray rather than along it, where rest looks the same?"""
    ray = track.position - T_world_cam0[:3, 3]
    along = float(track.velocity @ ray) / max(float(np.linalg.norm(ray)), _LEAST_DEPTH_M)
    across_squared = float(track.velocity @ track.velocity) - along**2
    return across_squared > (_ACROSS * along) ** 2


def _last_positions(before: FeatureMotions, feature_id: IntArray) -> FloatArray:
    """Positions (K, 3) of features (K,) in world; NaN where not known."""
    last = np.full((len(feature_id), 3), np.nan)
    at = positions(feature_id, before.feature_id)
    last[at >= 0] = before.p_world[at[at >= 0]]
    return last
