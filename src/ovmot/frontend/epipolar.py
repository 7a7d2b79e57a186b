"""Epipolar tests: stereo matches by the stereo extrinsics, consecutive images by a robust fit.

The distance of the right point to the epipolar line of the left one is taken in the undistorted
normalized plane, where it is exact for any lens; lines need not be horizontal.
"""

import math
from collections.abc import Callable

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.two_view_kernel import agree_with_translation_compiled
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.physics import LEAST_MATCH_SIGMA_PX
from ovmot.settings import EpipolarSettings
from ovmot.types import StereoMatches


def epipolar_lines(normalized_left: FloatArray, essential: FloatArray) -> FloatArray:
    """Lines (N, 3), a x + b y + c = 0 with a² + b² = 1, in the right normalized plane.

    `normalized_left` (N, 2); `essential` (3, 3): E = [t]x R of `T_cam1_cam0`. The line of x0 is
    E x0 (R. Hartley & A. Zisserman, ch. 9).
    """
    ones = np.ones_like(normalized_left[..., :1])
    lines = np.concatenate([normalized_left, ones], axis=-1) @ essential.T
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: FloatArray = lines / np.linalg.norm(lines[..., :2], axis=-1, keepdims=True)
    return unit


def scale_by_angle(lines: FloatArray, camera: Camera) -> FloatArray:
    """Normalized length of one pixel along the normal of each line (N, 3):
    √((n_x/fx)² + (n_y/fy)²), (N,)."""
    scale: FloatArray = np.hypot(lines[..., 0] / camera.fx, lines[..., 1] / camera.fy)
    return scale


def scale_by_fy(lines: FloatArray, camera: Camera) -> FloatArray:
    """Normalized length of one pixel, 1/fy for every line (N, 3): right for horizontal lines."""
    return np.full(lines.shape[:-1], 1.0 / camera.fy)


SCALES: dict[str, Callable[[FloatArray, Camera], FloatArray]] = {
    "angle": scale_by_angle,
    "fy": scale_by_fy,
}
"""From pixels to the normalized plane, by the setting `epipolar.scale`."""


def gate_matches(
    feature_id: IntArray,
    pixels: FloatArray,
    normalized: FloatArray,
    rig: StereoRig,
    settings: EpipolarSettings,
) -> StereoMatches:
    """Test N stereo matches, given as pixels (N, 4) and normalized coordinates (N, 4).

    Accepted are those at most `threshold_px` from their line; a match without finite coordinates
    (outside the camera model) is rejected.
    """
    lines = epipolar_lines(normalized[:, :2], rig.essential)
    right = normalized[:, 2:]
    off = np.abs((lines[:, :2] * right).sum(-1) + lines[:, 2])
    distance = off / SCALES[settings.scale](lines, rig.cam1)
    with np.errstate(invalid="ignore"):
        accepted = distance <= settings.threshold_px
    return StereoMatches(feature_id, pixels, distance, accepted, lines)


def no_matches() -> StereoMatches:
    """Of a frame without stereo matches."""
    ids, nothing = np.empty(0, dtype=np.int64), np.empty((0, 4))
    return StereoMatches(ids, nothing, nothing[:, 0], ids > 0, nothing[:, :3])


def without_rejected(values: FloatArray, matches: StereoMatches) -> FloatArray:
    """Pixels or normalized coordinates (N, 4), the right half NaN where the match was rejected."""
    out = values.copy()
    out[~matches.accepted, 2:] = np.nan
    return out


def match_sigma(matches: StereoMatches, *, tails: float = 1.5, min_matches: int = 20) -> float:
    """Standard deviation of each pixel of a stereo pair, by the accepted distances; NaN for few.

    A distance holds the noise of both pixels, and is all noise: what it shows across the line, the
    disparity has along it. Robust (1.4826 times the median, that of a normal distribution), at
    least what matching can reach (`physics.LEAST_MATCH_SIGMA_PX`), and wider by `tails`: matches
    have heavier tails than their median shows.
    """
    distance = matches.distance_px[matches.accepted]
    if len(distance) < min_matches:
        return float("nan")
    sigma = 1.4826 * float(np.median(distance)) / 2.0**0.5
    return float(tails * max(sigma, LEAST_MATCH_SIGMA_PX))


def two_view_inliers(
    before: FloatArray,
    now: FloatArray,
    R_now_before: FloatArray,
    threshold: float,
    *,
    min_points: int = 12,
    most_fitted: int = 200,
    confidence: float = 0.999,
) -> BoolArray:
    """Which of N tracks (N,) agree with one rigid motion of the camera between two images.

    `before`, `now` (N, 2): normalized coordinates; `R_now_before` (3, 3): predicted rotation;
    `threshold` in the unit of the coordinates, of the Sampson distance (R. Hartley & A. Zisserman,
    section 11.4). A RANSAC of two points (`two_view_kernel`) is fitted to every k-th track,
    `most_fitted` in all: more do not make it better by much. With fewer than `min_points` tracks,
    or when no motion is found, all pass: the test then knows nothing. So many samples are drawn
    that, where a third of the tracks are inliers, one is free of outliers with this `confidence`.
    """
    ok = np.asarray(np.isfinite(before).all(1) & np.isfinite(now).all(1))
    rows = np.flatnonzero(ok)
    if len(rows) < min_points:
        return ok
    fitted = np.arange(0, len(rows), -(-len(rows) // most_fitted))
    n_samples = math.ceil(math.log(1.0 - confidence) / math.log(1.0 - (1.0 / 3.0) ** 2))
    agree = agree_with_translation_compiled(
        np.ascontiguousarray(before[rows]), np.ascontiguousarray(now[rows]),
        np.ascontiguousarray(R_now_before), threshold, fitted, n_samples,
    )  # fmt: skip
    if agree.sum() < min_points:
        return ok
    inliers = np.zeros(len(ok), dtype=np.bool_)
    inliers[rows] = agree
    return inliers
