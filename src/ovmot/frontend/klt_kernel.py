"""Compiled pyramidal Lucas-Kanade flow of single points, forward and backward.

J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", 2000, with OpenCV's
criteria to stop and to reject. OpenCV's own function takes no pyramids from Python: it builds those
of both images at each of the many calls of a frame, and that costs more than the search.

Called by kernels only. `tests/frontend/test_klt_kernel.py` holds it against OpenCV.

Windows are kept as rows of `side + 3` pixels in one line of numbers: a loop over all of them runs
in SIMD lanes, where one per row would be too short. In the columns beyond the window the
derivatives are zero.
"""

import math

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import Image
from ovmot.kernels.cache import part, reordered_part

MAX_STEPS = 20
"""Steps of one level at most, as in OpenCV's sample program `lkdemo`."""
SMALL_STEP_PX = 0.01
"""A level is done at a step below this: the default of OpenCV's `calcOpticalFlowPyrLK`."""
MIN_CURVATURE = 1.024
"""Least eigenvalue of a window's mean squared gradient, (grey levels / pixel)²: 1024 times the
`minEigThreshold` 1e-3 of `lkdemo`, since OpenCV's derivatives have a gain of 32 and its sums a
scale of 2⁻²⁰."""
BACK_LEVELS = 2
"""The backward search starts where it should end: two levels are enough."""
MAX_ROUND_TRIP_PX = 0.7
"""Forward and backward: half a pixel in each direction of the image."""
LANES = 32
"""Pixels that one turn of a loop takes: two vectors of AVX-512, in single precision."""

_Float32 = npt.NDArray[np.float32]
_Images = tuple[Image, ...]


@reordered_part
def _copy_rows(
    image: Image, left: int, top: int, n_rows: int, stride: int, block: _Float32
) -> None:
    """Copy rows of an image, from pixel (left, top) on."""
    for i in range(n_rows):
        row, out = image[top + i, left:], block[i * stride :]
        for j in range(stride):
            out[j] = row[j]


@reordered_part
def _interpolate(block: _Float32, n: int, stride: int, a: float, b: float, grey: _Float32) -> None:
    """Bilinear grey levels, the first `n` pixels of a block shifted by (a, b), 0 to 1 each."""
    w00, w01 = np.float32((1.0 - a) * (1.0 - b)), np.float32(a * (1.0 - b))
    w10, w11 = np.float32((1.0 - a) * b), np.float32(a * b)
    right, below, corner = block[1:], block[stride:], block[stride + 1 :]
    for k in range(n):
        grey[k] = w00 * block[k] + w01 * right[k] + w10 * below[k] + w11 * corner[k]


@reordered_part
def _derivatives(wide: _Float32, n: int, stride: int, by_u: _Float32, by_v: _Float32) -> None:
    """Scharr's derivatives of a window from one that is wider by a pixel on each side."""
    three, ten = np.float32(3.0 / 32.0), np.float32(10.0 / 32.0)
    up, up_right = wide[1:], wide[2:]
    left, right = wide[stride:], wide[stride + 2 :]
    down_left, down, down_right = wide[2 * stride :], wide[2 * stride + 1 :], wide[2 * stride + 2 :]
    for k in range(n):
        fall, rise = down_right[k] - wide[k], up_right[k] - down_left[k]
        by_u[k] = three * (fall + rise) + ten * (right[k] - left[k])
        by_v[k] = three * (fall - rise) + ten * (down[k] - up[k])


@reordered_part
def _clear_outside(
    values: _Float32, side: int, left: int, top: int, right: int, bottom: int
) -> None:
    """Zero but in columns from `left` to before `right`, in rows from `top` to before `bottom`."""
    stride = side + 3
    for i in range(side):
        until = left if top <= i < bottom else stride
        for j in range(until):
            values[i * stride + j] = 0.0
        for j in range(right, stride):
            values[i * stride + j] = 0.0


@reordered_part
def _products(n: int, by_u: _Float32, by_v: _Float32) -> tuple[float, float, float]:
    """Sums of the derivatives' products: uu, uv, vv."""
    uu, uv, vv = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(n):
        uu += by_u[k] * by_u[k]
        uv += by_u[k] * by_v[k]
        vv += by_v[k] * by_v[k]
    return float(uu), float(uv), float(vv)


@reordered_part
def _mismatch(
    seen: _Float32, wide: _Float32, n: int, stride: int, by_u: _Float32, by_v: _Float32
) -> tuple[float, float]:
    """Sums of (what is seen less the window inside the wide one) times the derivatives."""
    u, v = np.float32(0.0), np.float32(0.0)
    inside = wide[stride + 1 :]
    for k in range(n):
        error = seen[k] - inside[k]
        u += error * by_u[k]
        v += error * by_v[k]
    return float(u), float(v)


@reordered_part
def _take_window(
    image: Image, left: int, top: int, a: float, b: float,
    side: int, border: tuple[int, int, int, int], room: _Float32,
) -> tuple[float, float, float]:  # fmt: skip
    """Fill `room` with the wide window at (left + a, top + b) and its derivatives; `_products`.

    `border`: first column and row, last column and row of the image, counted in the window.
    """
    block, wide, by_u, by_v = room[0], room[1], room[3], room[4]
    stride = side + 3
    n = side * stride
    _copy_rows(image, left, top, stride, stride, block)
    _interpolate(block, n + 2 * stride, stride, a, b, wide)
    _derivatives(wide, n, stride, by_u, by_v)
    first, last = max(0, border[0]), min(side, border[2])
    _clear_outside(by_u, side, first, border[1], last, border[3])
    _clear_outside(by_v, side, first, border[1], last, border[3])
    return _products(n, by_u, by_v)


@reordered_part
def _descend(
    image: Image, side: int, room: _Float32, u: float, v: float, uu: float, uv: float, vv: float
) -> tuple[float, float]:
    """Gauss-Newton steps from (u, v) in one level of the target, for the window in `room`.

    `uu`, `uv`, `vv`: the normal matrix, by `_products`.
    """
    block, wide, seen, by_u, by_v = room[0], room[1], room[2], room[3], room[4]
    margin, stride, half = side + 2, side + 3, 0.5 * (side - 1)
    lanes = -(-side * stride // LANES) * LANES  # zero derivatives beyond: no rest one by one
    height, width = image.shape[0] - 2 * margin, image.shape[1] - 2 * margin
    det = uu * vv - uv * uv
    last_u, last_v = 0.0, 0.0
    block_left, block_top = width, height  # of the block; nowhere yet
    for step in range(MAX_STEPS):
        x, y = u - half, v - half
        left, top = math.floor(x), math.floor(y)
        if not (-side <= left < width and -side <= top < height):
            break
        if left != block_left or top != block_top:
            _copy_rows(image, left + margin, top + margin, side + 1, stride, block)
            block_left, block_top = left, top
        _interpolate(block, lanes, stride, x - left, y - top, seen)
        bu, bv = _mismatch(seen, wide, lanes, stride, by_u, by_v)
        du, dv = (uv * bv - vv * bu) / det, (uv * bu - uu * bv) / det
        u, v = u + du, v + dv
        if du * du + dv * dv <= SMALL_STEP_PX**2:
            break
        if step > 0 and abs(du + last_u) < SMALL_STEP_PX and abs(dv + last_v) < SMALL_STEP_PX:
            return u - 0.5 * du, v - 0.5 * dv  # to and fro: the middle
        last_u, last_v = du, dv
    return u, v


@reordered_part
def search_flow(
    source: _Images, target: _Images, n_levels: int, side: int, room: _Float32,
    u0: float, v0: float, u1: float, v1: float,
) -> tuple[float, float, bool]:  # fmt: skip
    """Position in the target of (u0, v0) of the source, found from (u1, v1); whether it is found.

    `room` (5, (side + 4)² + LANES): memory to work in, zero at first.
    """
    margin, half, usable = side + 2, 0.5 * (side - 1), False
    scale = 0.5 ** (n_levels - 1)
    u, v = u1 * scale, v1 * scale
    for level in range(n_levels - 1, -1, -1):
        if level < n_levels - 1:
            u, v = 2.0 * u, 2.0 * v
        scale = 0.5**level
        height, width = target[level].shape[0] - 2 * margin, target[level].shape[1] - 2 * margin
        # the window in the source, with a pixel around it; nothing counts outside the image
        x, y = u0 * scale - half, v0 * scale - half
        left, top = math.floor(x), math.floor(y)
        usable = -side <= left < width and -side <= top < height
        if not usable:
            continue
        border = (-left, -top, width - 1 - left, height - 1 - top)
        x, y = x - left, y - top
        left, top = left + margin - 1, top + margin - 1
        uu, uv, vv = _take_window(source[level], left, top, x, y, side, border, room)
        least = 0.5 * (uu + vv - math.sqrt((uu - vv) ** 2 + 4.0 * uv * uv))
        usable = least >= MIN_CURVATURE * side * side
        if not usable:
            continue
        u, v = _descend(target[level], side, room, u, v, uu, uv, vv)
    x, y = u - half, v - half
    left, top = math.floor(x), math.floor(y)
    return u, v, usable and -side <= left < width and -side <= top < height


def margin_of(side: int) -> int:
    """Padding of each level in pixels, since a window may lie just outside the image."""
    return side + 2


@part
def flow_there_and_back(
    source: _Images, target: _Images, n_levels: int, side: int, room: _Float32,
    u0: float, v0: float, u1: float, v1: float,
) -> tuple[float, float, bool]:  # fmt: skip
    """Position in the target of (u0, v0) of the source, found from (u1, v1); whether it is found.

    It is where the search back from there ends where it began (Z. Kalal et al., ICPR 2010).

    `source`, `target`: pyramids, from fine to coarse, each level padded by `margin_of(side)` on all
    sides; `side` of the window in pixels.
    """
    u, v, ok = search_flow(source, target, n_levels, side, room, u0, v0, u1, v1)
    if not ok:
        return u, v, False
    back_levels = min(BACK_LEVELS, n_levels, len(source))
    back_u, back_v, ok = search_flow(target, source, back_levels, side, room, u, v, u0, v0)
    return u, v, ok and math.hypot(back_u - u0, back_v - v0) < MAX_ROUND_TRIP_PX
