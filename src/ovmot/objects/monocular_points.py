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
from ovmot.objects.track import ACROSS_SHARE, Track, TrackState
from ovmot.physics import CAR_SIZE_M
from ovmot.types import ScenePoints

_LEAST_DEPTH_M = 0.5


def with_track_depths(
    points: ScenePoints,
    tracks: Sequence[Track],
    before: FeatureMotions,
    since_s: float,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    pixel_sigma: float,
) -> ScenePoints:
    """The points, those of confirmed `tracks` without a stereo match at their track's depth.

    `tracks` are predicted to now; `before`: the features' positions `since_s` ago;
    `pixel_sigma`: standard deviation of a pixel coordinate. Along the ray it is a car's length: so
    great that nothing is measured along it.
    """
    monocular = np.flatnonzero(~np.isfinite(points.p_cam0[:, 2]))
    ids = points.feature_id[monocular]
    p_world = np.full((len(ids), 3), np.nan)
    last = None
    for track in tracks:
        if track.state != TrackState.TENTATIVE and _moves_across(track, T_world_cam0):
            own = contained(ids, track.feature_id)
            if own.any():
                last = _last_positions(before, ids) if last is None else last
                moved = last[own] + track.velocity * since_s
                p_world[own] = np.where(np.isfinite(moved), moved, track.position)
    if last is None:
        return points
    depth = se3.apply(se3.inverse(T_world_cam0), p_world)[:, 2]
    ahead = depth > _LEAST_DEPTH_M
    index, depth = monocular[ahead], depth[ahead]
    xy = rig.cam0.normalize(points.pixels[index, :2])
    ray = np.column_stack([xy, np.ones(len(index))])
    across = (pixel_sigma / rig.cam0.fx * depth) ** 2
    along = CAR_SIZE_M[0] ** 2 * ray[:, :, None] * ray[:, None]
    p_cam0, cov_cam0 = points.p_cam0.copy(), points.cov_cam0.copy()
    p_cam0[index] = ray * depth[:, None]
    cov_cam0[index] = across[:, None, None] * np.eye(3) + along
    return replace(points, p_cam0=p_cam0, cov_cam0=cov_cam0)


def _moves_across(track: Track, T_world_cam0: FloatArray) -> bool:
    """Does a track move across its ray rather than along it, where rest looks the same?"""
    ray = track.position - T_world_cam0[:3, 3]
    along = float(track.velocity @ ray) / max(float(np.linalg.norm(ray)), _LEAST_DEPTH_M)
    across_squared = float(track.velocity @ track.velocity) - along**2
    return across_squared > (ACROSS_SHARE * along) ** 2


def _last_positions(before: FeatureMotions, feature_id: IntArray) -> FloatArray:
    """Positions (K, 3) of features (K,) in world; NaN where not known."""
    last = np.full((len(feature_id), 3), np.nan)
    at = positions(feature_id, before.feature_id)
    last[at >= 0] = before.p_world[at[at >= 0]]
    return last
