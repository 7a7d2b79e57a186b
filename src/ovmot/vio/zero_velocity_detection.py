"""Does the picture say that the rig stands? Points that keep their place, and no metric motion.

Both look back over some tenths of a second: from one frame to the next a creeping rig moves less
than a match is accurate, and the less, the faster the frames.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.stereo_motion import motion_is_significant, solve_stereo_motion
from ovmot.settings import ZeroVelocitySettings
from ovmot.types import tracked_pixels

_MIN_POINTS = 8
_MAX_POINTS = 60
_PIXEL_SIGMA = 0.5  # of a stereo match, for the metric motion
_ROTATION_SIGMA = 1e-3  # rad over the look-back, if the rig stands
_MIN_MOTION_M = 0.01  # less is a body rocking on its springs


def still_share(
    pixels: FloatArray, earlier: FloatArray, candidates: BoolArray, pixel: float
) -> float:
    """Share of candidate points whose image position moved less than `pixel`.

    `pixels`, `earlier` (N, 2), NaN where unseen; 0 with fewer than 8 points to look at.
    """
    both = candidates & np.isfinite(pixels[:, 0]) & np.isfinite(earlier[:, 0])
    if both.sum() < _MIN_POINTS:
        return 0.0
    moved = np.linalg.norm(pixels[both] - earlier[both], axis=1)
    return float((moved < pixel).mean())


def image_is_stationary(
    table: FeatureTable, rig: StereoRig, settings: ZeroVelocitySettings
) -> bool:
    """Do most points of the newest row, and their common stereo motion, say that nothing moved?

    Compared with the oldest row at most `look_back_s` ago; False while there is none at least half
    as old. Suspect and barred features are left out.
    """
    if table.shape[0] < 2:
        return False
    age = (table.frame_ns[-1] - table.frame_ns) * 1e-9
    row = int(np.flatnonzero(age <= settings.look_back_s * 1.01)[0])
    if age[row] < 0.5 * settings.look_back_s:
        return False
    candidates = ~table.outlier & ~table.dynamic
    now, then = tracked_pixels(table.pixels[-1]), tracked_pixels(table.pixels[row])
    share = still_share(now, then, candidates, settings.pixel)
    if share < settings.still_share:
        return False
    return not _has_moved(table.normalized[row, candidates], table.normalized[-1, candidates], rig)


def _has_moved(before: FloatArray, now: FloatArray, rig: StereoRig) -> bool:
    """Is there a translation of the left camera beyond its own uncertainty and a centimetre?"""
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    sigma = _PIXEL_SIGMA / np.array([f0[0], f0[1], f1[0], f1[1]])
    disparity = np.nan_to_num(before[:, 0] - before[:, 2])
    nearest = np.argsort(-disparity, kind="stable")[:_MAX_POINTS]  # they tell motion best
    motion = solve_stereo_motion(
        before[nearest], now[nearest], rig.T_cam1_cam0, np.eye(3), sigma, _ROTATION_SIGMA
    )
    if motion is None:
        return False  # too few stereo points to say
    return motion_is_significant(motion, _MIN_MOTION_M)
