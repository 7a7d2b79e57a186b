"""Compiled search of patches along their epipolar curves: where in the other image, and whether
only there.

Normalized cross-correlation of windows on images of half size. The pixels along a curve are copied
into a straight strip first: loops over all places at once then run in SIMD lanes.
tests/frontend/test_epipolar_scan_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ovmot.cameras.lens_kernel import to_pixel
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.kernels.cache import code_folder, compiled, part, reordered_part

_Float32 = npt.NDArray[np.float32]

HALF = 3
"""Half the side of a window on the half-size images: it shows as much as a patch does."""
_SIDE = 2 * HALF + 1
_PIECES = 4
"""Of an epipolar curve, each of which counts as straight: lenses bend it."""
_FEWEST_PLACES = 3  # for a maximum
_LEAST_VARIANCE = 1.0
"""Grey levels squared, of a whole window: one with less contrast shows noise."""


class ScanRules(NamedTuple):
    """A curve reaches from infinity to `least_depth`, metres. A window fits where its correlation
    is a maximum of at least `least`, and as well at another one if the distances, the square roots
    of 1 less the correlation, are in a greater ratio than `ratio`. What noise takes off every
    correlation, with a standard deviation of `noise` grey levels, tells nothing."""

    least_depth: float
    least: float
    ratio: float
    noise: float


@part
def _curve(
    x: float, y: float, T: FloatArray, lens: int, camera: FloatArray, least_depth: float,
    nodes: FloatArray,
) -> bool:  # fmt: skip
    """Fill `nodes` (n, 2), half-size pixels, from infinity to the least depth; False where one is
    not seen."""
    n = len(nodes)
    for k in range(n):
        rho = k / ((n - 1) * least_depth)
        q = T[2, 0] * x + T[2, 1] * y + T[2, 2] + rho * T[2, 3]
        if q <= 0.0:
            return False
        a = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + rho * T[0, 3]) / q
        b = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + rho * T[1, 3]) / q
        u, v = to_pixel(lens, camera, a, b)
        nodes[k, 0], nodes[k, 1] = 0.5 * u, 0.5 * v
        if not math.isfinite(u + v):
            return False
    return True


@part
def _rising(nodes: FloatArray) -> int:
    """The axis along which a curve mostly runs; its nodes are put in order to rise there."""
    n = len(nodes)
    du, dv = nodes[n - 1, 0] - nodes[0, 0], nodes[n - 1, 1] - nodes[0, 1]
    along = 0 if abs(du) >= abs(dv) else 1
    if nodes[n - 1, along] < nodes[0, along]:
        for k in range(n // 2):
            for a in range(2):
                first, last = nodes[k, a], nodes[n - 1 - k, a]
                nodes[k, a], nodes[n - 1 - k, a] = last, first
    return along


@part
def _piece(nodes: FloatArray, along: int, at: float, k: int) -> int:
    """The piece, `k` or a later one, in which a place of the axis `along` lies."""
    while k < len(nodes) - 2 and nodes[k + 1, along] < at:
        k += 1
    return k


@part
def _across(nodes: FloatArray, along: int, at: float, k: int) -> float:
    """Where piece k is in the other axis, at a place of the axis `along`; the ends go on."""
    other = 1 - along
    span = nodes[k + 1, along] - nodes[k, along]
    share = (at - nodes[k, along]) / span if abs(span) > 1e-9 else 0.0
    return float(nodes[k, other] + share * (nodes[k + 1, other] - nodes[k, other]))


@reordered_part
def _correlate(strip: _Float32, window: _Float32, n: int, room: _Float32, out: _Float32) -> None:
    """Fill out (n,): the correlation of a window of zero mean and unit norm with the strip.

    `room` (2, at least n + 6) to work in.
    """
    total, square = room[0], room[1]
    for x in range(n + 2 * HALF):
        total[x] = square[x] = np.float32(0.0)
    for i in range(_SIDE):
        for x in range(n + 2 * HALF):
            total[x] += strip[i, x]
            square[x] += strip[i, x] * strip[i, x]
    for x in range(n):  # the columns of a window, from its first one on
        columns, squares = np.float32(0.0), np.float32(0.0)
        for j in range(_SIDE):
            columns += total[x + j]
            squares += square[x + j]
        variance = squares - columns * columns * np.float32(1.0 / (_SIDE * _SIDE))
        square[x] = np.float32(1.0) / np.sqrt(max(variance, np.float32(_LEAST_VARIANCE)))
        out[x] = np.float32(0.0)
    for i in range(_SIDE):
        for j in range(_SIDE):
            weight = window[i, j]
            for x in range(n):
                out[x] += weight * strip[i, x + j]
    for x in range(n):
        out[x] *= square[x]


@part
def _peaks(score: _Float32, n: int) -> tuple[float, float, float]:
    """The greatest maximum of a score (n,): its place and height, by a parabola, and the height of
    the next greatest one, -1 where there is none."""
    best, place, second = -1.0, 0.0, -1.0
    for x in range(1, n - 1):
        here, before, after = float(score[x]), float(score[x - 1]), float(score[x + 1])
        if here >= before and here > after:
            bend, slope = before - 2.0 * here + after, 0.5 * (after - before)
            height = min(here - 0.5 * slope * slope / bend, 1.0) if bend < 0.0 else here
            if height > best:
                best, place, second = height, x - (slope / bend if bend < 0.0 else 0.0), best
            elif height > second:
                second = height
    return place, best, second


@part
def _take_window(left: Image, margin: int, u: int, v: int, window: _Float32) -> float:
    """Fill the window around pixel (u, v) of the left image, of zero mean and unit norm; the norm
    that it had, grey levels."""
    mean, norm, area = 0.0, 0.0, _SIDE * _SIDE
    for i in range(_SIDE):
        for j in range(_SIDE):
            window[i, j] = left[v + i - HALF + margin, u + j - HALF + margin]
            mean += window[i, j] / area
    for i in range(_SIDE):
        for j in range(_SIDE):
            window[i, j] -= mean
            norm += window[i, j] ** 2
    norm = math.sqrt(max(norm, _LEAST_VARIANCE))
    for i in range(_SIDE):
        for j in range(_SIDE):
            window[i, j] /= norm
    return norm


@part
def _take_strip(
    right: Image, margin: int, nodes: FloatArray, along: int, strip: _Float32
) -> tuple[int, int]:
    """Fill the strip along a curve, and a window's half to each side; the first place of a window's
    centre on the axis `along`, and that after the last one."""
    size, across = right.shape[1 - along] - 2 * margin, right.shape[along] - 2 * margin
    begin = max(math.floor(nodes[0, along]) - 1, HALF)
    end, k = min(math.ceil(nodes[len(nodes) - 1, along]) + 2, size - HALF), 0
    for x in range(begin - HALF, end + HALF):
        k = _piece(nodes, along, float(x), k)
        middle = min(max(_across(nodes, along, float(x), k), HALF), across - HALF - 1.0)
        first_row, column = math.floor(middle), x + margin
        share = np.float32(middle - first_row)
        for i in range(_SIDE):
            row = first_row + i - HALF + margin
            grey = right[row, column] if along == 0 else right[column, row]
            below = right[row + 1, column] if along == 0 else right[column, row + 1]
            strip[i, x - begin + HALF] = grey + share * (np.float32(below) - np.float32(grey))
    return begin, end


def scan_curves(
    left: Image, right: Image, margin: int, uv: FloatArray, xy: FloatArray, wanted: BoolArray,
    T: FloatArray, lens: int, camera: FloatArray, rules: ScanRules,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Right pixels (N, 2) where the windows around left pixels `uv` (N, 2) fit best, NaN where they
    fit nowhere; and where they fit as well at another place (N,).

    `left`, `right`: images of half size, padded by `margin`; `xy` (N, 2): normalized coordinates;
    only the features that are `wanted` (N,) are sought. T (4, 4): `T_cam1_cam0`; `lens`, `camera`:
    of the right camera, see `lens_kernel.packed_camera`.
    """
    found, ambiguous = np.full((len(uv), 2), math.nan), np.zeros(len(uv), np.bool_)
    height, width = left.shape[0] - 2 * margin, left.shape[1] - 2 * margin
    longest = max(right.shape)
    window, strip = np.empty((_SIDE, _SIDE), np.float32), np.empty((_SIDE, longest), np.float32)
    room, score = np.empty((2, longest), np.float32), np.empty(longest, np.float32)
    nodes = np.empty((_PIECES + 1, 2))
    for n in range(len(uv)):
        u, v = math.floor(0.5 * uv[n, 0] + 0.5), math.floor(0.5 * uv[n, 1] + 0.5)
        inside = HALF <= u < width - HALF and HALF <= v < height - HALF
        if not (wanted[n] and inside):
            continue
        if not _curve(xy[n, 0], xy[n, 1], T, lens, camera, rules.least_depth, nodes):
            continue
        off_u, off_v = 0.5 * uv[n, 0] - u, 0.5 * uv[n, 1] - v  # of the window's centre
        nodes[:, 0] -= off_u
        nodes[:, 1] -= off_v
        along = _rising(nodes)
        begin, end = _take_strip(right, margin, nodes, along, strip)
        if end - begin < _FEWEST_PLACES:
            continue
        norm = _take_window(left, margin, u, v, window)
        if along == 1:
            window[:] = window.T.copy()
        _correlate(strip, window, end - begin, room, score)
        place, best, second = _peaks(score, end - begin)
        if best >= rules.least:
            at = begin + place
            found[n, along] = 2.0 * at
            found[n, 1 - along] = 2.0 * _across(nodes, along, at, _piece(nodes, along, at, 0))
            found[n, 0] += 2.0 * off_u
            found[n, 1] += 2.0 * off_v
            blur = (rules.noise * _SIDE / norm) ** 2
            ambiguous[n] = 1.0 - best + blur > rules.ratio**2 * (1.0 - second + blur)
    return found, ambiguous


_FOLDER = code_folder(Path(__file__))
scan_curves_compiled = compiled(scan_curves, _FOLDER)
