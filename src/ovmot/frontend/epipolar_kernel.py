"""The compiled epipolar gate of stereo matches, and where the matched points are.

The plain NumPy twin is in `tests/frontend/test_epipolar_kernel.py`.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.stereo import triangulate


class GatedPairs(NamedTuple):
    """N features after the gate, and the M of them that have both halves: those `tested`.

    `pixels`, `normalized` (N, 4): the right half NaN where the match was rejected; `p_cam0` (N, 3)
    in the left camera, metres, NaN where there is no match, or none in front of both cameras.
    `tested` (M,) of N, `distance_px` (M,), `accepted` (M,), `line` (M, 3): as `StereoMatches`.
    """

    pixels: FloatArray
    normalized: FloatArray
    p_cam0: FloatArray
    tested: IntArray
    distance_px: FloatArray
    accepted: BoolArray
    line: FloatArray


def gate_pairs(
    pixels: FloatArray, normalized: FloatArray,
    E: FloatArray, focal: FloatArray, threshold_px: float, T_cam1_cam0: FloatArray,
) -> GatedPairs:  # fmt: skip
    """Test stereo matches, `pixels` and `normalized` (N, 4), by their distance from the line E x0.

    `focal` (2,): what the normal (a, b) of a line is divided by to bring the distance to pixels.
    """
    n, count = len(pixels), 0
    out = GatedPairs(
        pixels.copy(), normalized.copy(), np.full((n, 3), np.nan), np.empty(n, np.int64),
        np.empty(n), np.empty(n, np.bool_), np.empty((n, 3)),
    )  # fmt: skip
    for i in range(n):
        if not (math.isfinite(pixels[i, 0]) and math.isfinite(pixels[i, 2])):
            continue
        x, y = normalized[i, 0], normalized[i, 1]
        a, b = E[0, 0] * x + E[0, 1] * y + E[0, 2], E[1, 0] * x + E[1, 1] * y + E[1, 2]
        c, size = E[2, 0] * x + E[2, 1] * y + E[2, 2], math.hypot(a, b)
        a, b, c = a / size, b / size, c / size
        scale = math.hypot(a / focal[0], b / focal[1])
        distance = abs(a * normalized[i, 2] + b * normalized[i, 3] + c) / scale
        accepted = distance <= threshold_px
        out.tested[count], out.distance_px[count], out.accepted[count] = i, distance, accepted
        out.line[count, 0], out.line[count, 1], out.line[count, 2] = a, b, c
        count += 1
        if not accepted:
            for k in range(2, 4):
                out.pixels[i, k] = out.normalized[i, k] = math.nan
        elif not triangulate(normalized[i], T_cam1_cam0, out.p_cam0[i]):
            out.p_cam0[i, :] = math.nan
    return GatedPairs(
        out.pixels, out.normalized, out.p_cam0, out.tested[:count],
        out.distance_px[:count], out.accepted[:count], out.line[:count],
    )  # fmt: skip


@part
def is_free(u: float, v: float, mask: Image, width: int, height: int, border_px: int) -> bool:
    """Does a pixel lie at least `border_px` inside an image of this size, where `mask` is zero?

    The mask is of the image's size, or empty. NaN lies nowhere.
    """
    inside = border_px <= u <= width - 1 - border_px and border_px <= v <= height - 1 - border_px
    return inside and (len(mask) == 0 or mask[int(np.rint(v)), int(np.rint(u))] == 0)


def pair_up(
    uv: FloatArray, xy: FloatArray, right_uv: FloatArray, right_xy: FloatArray, found: BoolArray,
    mask: Image, width: int, height: int, border_px: int,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Pixels and normalized coordinates (N, 4) of features in both images.

    `uv`, `xy` (N, 2) of the left one; `right_uv`, `right_xy` (N, 2) of the right one, where they
    were `found` (N,) and `is_free` there; else NaN.
    """
    pixels, normalized = np.full((len(uv), 4), np.nan), np.full((len(uv), 4), np.nan)
    for i in range(len(uv)):
        matched = found[i] and is_free(
            right_uv[i, 0], right_uv[i, 1], mask, width, height, border_px
        )
        for k in range(2):
            pixels[i, k], normalized[i, k] = uv[i, k], xy[i, k]
            if matched:
                pixels[i, k + 2], normalized[i, k + 2] = right_uv[i, k], right_xy[i, k]
    return pixels, normalized


_folder = code_folder(Path(__file__))
gate_pairs_compiled = compiled(gate_pairs, _folder)
pair_up_compiled = compiled(pair_up, _folder)
