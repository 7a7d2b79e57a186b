"""Features of tracks that only the left camera sees: the track tells how far away they are.

A body that leaves the picture, or goes behind another one, is lost to the right camera first. Its
features then still tell how it moves across the rays, and nothing of what it does along them.
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
_DEPTH_SIGMA_M = 4.0  # by which nothing is learned along the ray
_LEAST_DEPTH_M = 0.5
_ACROSS = 0.5  # of the velocity along the ray, that one across it must be at least


def placed_by_tracks(
    seen: ScenePoints,
    tracks: Sequence[Track],
    before: FeatureMotions,
    since_s: float,
    T_world_cam0: FloatArray,
    rig: StereoRig,
) -> ScenePoints:
    """The points, those of confirmed `tracks` without a stereo match at the depth they should have.

    `tracks` are carried to now; `before`: where the features were, `since_s` ago.
    """
    alone = ~np.isfinite(seen.p_cam0[:, 2])
    last = _last_places(before, seen.feature_id)
    p_world = np.full((len(alone), 3), np.nan)
    for track in tracks:
        if track.state != TrackState.TENTATIVE and _goes_across(track, T_world_cam0):
            own = alone & contained(seen.feature_id, track.feature_id)
            moved = last[own] + track.velocity * since_s
            p_world[own] = np.where(np.isfinite(moved), moved, track.position)
    depth = se3.apply(se3.inverse(T_world_cam0), p_world)[:, 2]
    placed = np.flatnonzero(depth > _LEAST_DEPTH_M)
    depth, xy = depth[placed], rig.cam0.normalize(seen.pixels[placed, :2])
    ray = np.column_stack([xy, np.ones(len(placed))])
    across = (_PIXEL_SIGMA / rig.cam0.fx * depth) ** 2
    along = _DEPTH_SIGMA_M**2 * ray[:, :, None] * ray[:, None]
    p_cam0, cov_cam0 = seen.p_cam0.copy(), seen.cov_cam0.copy()
    p_cam0[placed] = ray * depth[:, None]
    cov_cam0[placed] = across[:, None, None] * np.eye(3) + along
    return replace(seen, p_cam0=p_cam0, cov_cam0=cov_cam0)


def _goes_across(track: Track, T_world_cam0: FloatArray) -> bool:
    """Does a track go across its ray rather than along it? Along it, what rests looks the same."""
    ray = track.position - T_world_cam0[:3, 3]
    along = float(track.velocity @ ray) / max(float(np.linalg.norm(ray)), _LEAST_DEPTH_M)
    across_squared = float(track.velocity @ track.velocity) - along**2
    return across_squared > (_ACROSS * along) ** 2


def _last_places(before: FeatureMotions, feature_id: IntArray) -> FloatArray:
    """Where features (K,) were in the world (K, 3); NaN where not known."""
    places = np.full((len(feature_id), 3), np.nan)
    at = positions(feature_id, before.feature_id)
    places[at >= 0] = before.p_world[at[at >= 0]]
    return places
