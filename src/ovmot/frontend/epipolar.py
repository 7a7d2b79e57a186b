"""The epipolar gate: stereo matches checked by the stereo extrinsics.

The distance of the right point to the left point's epipolar line is taken in the undistorted
normalised plane, where it is exact for any lens; lines need not be horizontal.
"""

from collections.abc import Callable

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import EpipolarSettings
from ovmot.types import StereoMatches

_MIN_MATCHES = 20
_TAILS = 1.5
_LEAST_SIGMA_PX = 0.15


def epipolar_lines(normalized_left: FloatArray, essential: FloatArray) -> FloatArray:
    """Lines (N, 3), a x + b y + c = 0 with a² + b² = 1, in the right plane: E x0 (E = [t]x R)."""
    ones = np.ones_like(normalized_left[..., :1])
    lines = np.concatenate([normalized_left, ones], axis=-1) @ essential.T
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: FloatArray = lines / np.linalg.norm(lines[..., :2], axis=-1, keepdims=True)
    return unit


def scale_by_angle(lines: FloatArray, camera: Camera) -> FloatArray:
    """Plane units of one pixel along each line's normal (N,): √((n_x/fx)² + (n_y/fy)²)."""
    scale: FloatArray = np.hypot(lines[..., 0] / camera.fx, lines[..., 1] / camera.fy)
    return scale


def scale_by_fy(lines: FloatArray, camera: Camera) -> FloatArray:
    """Plane units of one pixel, 1/fy for every line: right where lines are horizontal."""
    return np.full(lines.shape[:-1], 1.0 / camera.fy)


SCALES: dict[str, Callable[[FloatArray, Camera], FloatArray]] = {
    "angle": scale_by_angle,
    "fy": scale_by_fy,
}


def gate_matches(
    feature_id: IntArray,
    pixels: FloatArray,
    normalized: FloatArray,
    rig: StereoRig,
    settings: EpipolarSettings,
) -> StereoMatches:
    """Test N stereo matches, given as pixels and plane coordinates (N, 4).

    Accepted are those at most `threshold_px` from their line; a
    match without finite coordinates (outside the lens model) is refused.
    """
    lines = epipolar_lines(normalized[:, :2], rig.essential)
    right = normalized[:, 2:]
    off = np.abs((lines[:, :2] * right).sum(-1) + lines[:, 2])
    distance = off / SCALES[settings.scale](lines, rig.cam1)
    with np.errstate(invalid="ignore"):
        accepted = distance <= settings.threshold_px
    return StereoMatches(feature_id, pixels, distance, accepted, lines)


def no_matches() -> StereoMatches:
    """Nothing was matched."""
    ids, nothing = np.empty(0, dtype=np.int64), np.empty((0, 4))
    return StereoMatches(ids, nothing, nothing[:, 0], ids > 0, nothing[:, :3])


def match_sigma(matches: StereoMatches) -> float:
    """Standard deviation of each pixel of a stereo pair, by the accepted distances; NaN for few.

    A distance holds the noise of both pixels, and is all noise: what it shows across the line, the
    disparity has along it. Robust (1.4826 times the median), and widened for the heavier tails
    that matches have.
    """
    distance = matches.distance_px[matches.accepted]
    if len(distance) < _MIN_MATCHES:
        return float("nan")
    sigma = 1.4826 * float(np.median(distance)) / 2.0**0.5
    return float(max(_TAILS * sigma, _LEAST_SIGMA_PX))


def without_refused(values: FloatArray, matches: StereoMatches) -> FloatArray:
    """Pixels or plane coordinates (N, 4) with the right half NaN where the match was refused."""
    out = values.copy()
    out[~matches.accepted, 2:] = np.nan
    return out
