"""Epipolar tests: stereo matches by the stereo extrinsics, consecutive images by a robust fit.

The distance of the right point to the epipolar line of the left one is taken in the undistorted
normalized plane, where it is exact for any lens; lines need not be horizontal.
"""

import math
from collections.abc import Callable

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.epipolar_kernel import GatedPairs, gate_pairs_compiled
from ovmot.frontend.two_view_kernel import agree_with_translation_compiled
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.physics import epipolar_pixel_sigma
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


def focal_lengths(camera: Camera) -> FloatArray:
    """(fx, fy): a distance in the normalized plane has the pixels that its normal gives it."""
    return np.array([camera.fx, camera.fy])


def focal_length_of_rows(camera: Camera) -> FloatArray:
    """(fy, fy): the same for any line, which is right for horizontal ones."""
    return np.array([camera.fy, camera.fy])


SCALES: dict[str, Callable[[Camera], FloatArray]] = {
    "angle": focal_lengths,
    "fy": focal_length_of_rows,
}
"""What the unit normal (a, b) of a line is divided by, component by component: the length of the
quotient is that of a pixel along the normal. By the setting `epipolar.scale`."""


def gate_matches(
    feature_id: IntArray,
    pixels: FloatArray,
    normalized: FloatArray,
    rig: StereoRig,
    settings: EpipolarSettings,
) -> tuple[GatedPairs, StereoMatches]:
    """Test the stereo matches among N features: the features after it, and the tested matches.

    `pixels`, `normalized` (N, 4): the right half NaN where there is no match. Accepted are those at
    most `threshold_px` from their line; a match without finite coordinates (outside the camera
    model) is rejected.
    """
    gated = gate_pairs_compiled(
        pixels, normalized, rig.essential, SCALES[settings.scale](rig.cam1),
        settings.threshold_px, np.ascontiguousarray(rig.T_cam1_cam0),
    )  # fmt: skip
    tested = gated.tested
    return gated, StereoMatches(
        feature_id[tested], pixels[tested], gated.distance_px, gated.accepted, gated.line
    )


def no_matches() -> StereoMatches:
    """Of a frame without stereo matches."""
    ids, nothing = np.empty(0, dtype=np.int64), np.empty((0, 4))
    return StereoMatches(ids, nothing, nothing[:, 0], ids > 0, nothing[:, :3])


def match_sigma(matches: StereoMatches) -> float:
    """Standard deviation of each pixel of a stereo pair, by the accepted distances; NaN for few.
    See `physics.epipolar_pixel_sigma`."""
    return epipolar_pixel_sigma(matches.distance_px[matches.accepted])


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
