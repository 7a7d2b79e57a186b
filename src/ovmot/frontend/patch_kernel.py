"""Compiled work on single patches: cut one from an image, align one with an image.

Called by kernels only; arrays are filled in place. A patch has `PIXELS` pixels by rows, in arrays
of `PADDED`: a loop over all of them then runs in SIMD lanes without a rest, and what lies beyond
the patch has no weight. `tests/frontend/test_patch_kernel.py` holds the plain NumPy twins.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import inlined_part, inlined_reordered_part, part, reordered_part
from ovmot.kernels.small_matrices import invert_definite

_Float32 = npt.NDArray[np.float32]
Quads = npt.NDArray[np.int32]
"""Words of four grey levels: those of a pixel, of its right, lower and lower right neighbours."""

RADIUS = 6
"""Pixels from the centre of a patch to its border: it is 13 wide, 2 more than a window of flow."""
SIDE = 2 * RADIUS + 1
PIXELS = SIDE * SIDE
PADDED = -(-PIXELS // 16) * 16
"""Pixels in memory: whole vectors of AVX-512, in single precision."""
SIGMA_PX = RADIUS / 2
"""Of the weight, as D. Lowe has it for descriptors (IJCV 2004): half of the patch's half width. A
patch that moves by more than this from where it was expected has found another one."""
LEAST_NORM = 1e-3
"""Grey levels: a patch without any contrast is divided by this."""
MARGIN = 3 * RADIUS
"""Pixels around an image that repeat its border: a patch may reach beyond it."""
_SHIFT = 64
"""Added to pixels relative to the patch's centre: what is cut off to a whole number is positive."""


def _padded(values: FloatArray) -> _Float32:
    return np.pad(values.ravel(), (0, PADDED - PIXELS)).astype(np.float32)


_row, _column = np.mgrid[-RADIUS : RADIUS + 1, -RADIUS : RADIUS + 1].astype(np.float64)
OFFSET_U, OFFSET_V = _padded(_column), _padded(_row)
_SHARE_U, _SHARE_V = _padded(_column / RADIUS), _padded(_row / RADIUS)
ROOT_WEIGHT = _padded(np.exp(-0.25 * (_column**2 + _row**2) / SIGMA_PX**2))
ROOT_WEIGHT /= np.linalg.norm(ROOT_WEIGHT)
"""Square root of a Gaussian weight of sum one: what lies off the centre counts less, since at an
outline it belongs to another body."""


class Patch(NamedTuple):
    """A patch: `grey` levels (PADDED,), weighted, of zero mean and unit norm; their derivatives by
    a shift, `slope` (2, PADDED), weighted; the `inverse` (6, 6) of the curvature.

    The other four derivatives, by the warp's numbers times the radius, are these times a pixel's
    place in the patch. `gain` (6, 2): how much of each of the six is an offset of all grey levels,
    and how much a gain. That is taken off: patches are compared without them.
    """

    grey: _Float32
    slope: _Float32
    gain: _Float32
    inverse: _Float32


class Room(NamedTuple):
    """Memory for one alignment, (PADDED,) each: words `quad` of four grey levels, their `place` in
    the image, fractions `a`, `b` of a pixel beyond them; `sums` (9,), `step` (6,)."""

    quad: Quads
    place: Quads
    a: _Float32
    b: _Float32
    sums: FloatArray
    step: FloatArray


@part
def make_room() -> Room:
    """Room for alignments, one after the other."""
    return Room(
        np.zeros(PADDED, np.int32), np.zeros(PADDED, np.int32),
        np.zeros(PADDED, np.float32), np.zeros(PADDED, np.float32), np.zeros(9), np.zeros(6),
    )  # fmt: skip


@inlined_reordered_part
def _locate(u: float, v: float, warp: FloatArray, stride: int, room: Room) -> None:
    """Fill `place`, `a` and `b` of the room for the pixels at (u, v) + warp x of all offsets x,
    with (u, v) relative to a corner that leaves all of them positive: single precision is enough.
    """
    u0, v0, row_length = np.float32(u), np.float32(v), np.int32(stride)
    w00, w01 = np.float32(warp[0, 0]), np.float32(warp[0, 1])
    w10, w11 = np.float32(warp[1, 0]), np.float32(warp[1, 1])
    place, a, b = room.place, room.a, room.b
    for m in range(PADDED):
        x = u0 + w00 * OFFSET_U[m] + w01 * OFFSET_V[m]
        y = v0 + w10 * OFFSET_U[m] + w11 * OFFSET_V[m]
        column, row = np.int32(x), np.int32(y)
        a[m], b[m] = x - np.float32(column), y - np.float32(row)
        place[m] = np.int32(row * row_length + column)


@inlined_part
def _load(words: Quads, corner: int, room: Room) -> None:
    """Fill `quad` of the room by the words at `place`, counted from `corner`."""
    for m in range(PADDED):
        room.quad[m] = words[np.uint64(corner + room.place[m])]


@inlined_reordered_part
def _sum_up(room: Room, centre: float, grey: _Float32, slope: _Float32, gain: _Float32) -> None:
    """Fill `sums` of the room: of weighted grey levels with the patch's derivatives (6), with the
    weight, with themselves and with the patch; less `centre`, which keeps them small."""
    s0, s1, s2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    s3, s4, s5 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    mean, square, product = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    middle = np.float32(centre)
    quad, a, b = room.quad, room.a, room.b
    for m in range(PADDED):
        word = quad[m]
        here, right = np.float32(np.int32(word & 255)), np.float32(np.int32((word >> 8) & 255))
        below = np.float32(np.int32((word >> 16) & 255))
        diagonal = np.float32(np.int32((word >> 24) & 255))
        upper, lower = here + a[m] * (right - here), below + a[m] * (diagonal - below)
        seen = ROOT_WEIGHT[m] * (upper + b[m] * (lower - upper) - middle)
        mean += ROOT_WEIGHT[m] * seen
        square += seen * seen
        product += seen * grey[m]
        by_u, by_v = seen * slope[0, m], seen * slope[1, m]
        s0 += by_u
        s1 += by_v
        s2 += by_u * _SHARE_U[m]
        s3 += by_u * _SHARE_V[m]
        s4 += by_v * _SHARE_U[m]
        s5 += by_v * _SHARE_V[m]
    sums = room.sums
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = s0, s1, s2, s3, s4, s5
    sums[6], sums[7], sums[8] = mean, square, product
    for k in range(6):
        sums[k] -= gain[k, 0] * mean + gain[k, 1] * product


@inlined_part
def _compare(words: Quads, u: float, v: float, warp: FloatArray, patch: Patch, room: Room) -> float:
    """Correlation of a patch with the image at (u, v) under the warp; the gradient in `sums[:6]`.

    -1 where the patch reaches beyond the image's margin. Patch and derivatives are orthogonal to
    the root weight, and these to the patch: the mean of what is seen falls out of the sums.
    """
    height, width = words.shape
    u, v = u + MARGIN, v + MARGIN
    reach_u = (abs(warp[0, 0]) + abs(warp[0, 1])) * RADIUS + 1.0
    reach_v = (abs(warp[1, 0]) + abs(warp[1, 1])) * RADIUS + 1.0
    if not (reach_u < _SHIFT and reach_u <= u < width - 1 - reach_u):
        return -1.0
    if not (reach_v < _SHIFT and reach_v <= v < height - 1 - reach_v):
        return -1.0
    left, top = math.floor(u), math.floor(v)
    centre = words[top, left] & 255
    _locate(u - left + _SHIFT, v - top + _SHIFT, warp, width, room)
    _load(words.ravel(), (top - _SHIFT) * width + left - _SHIFT, room)
    _sum_up(room, centre, patch.grey, patch.slope, patch.gain)
    sums = room.sums
    norm = max(math.sqrt(max(sums[7] - sums[6] * sums[6], 0.0)), LEAST_NORM)
    for k in range(6):
        sums[k] /= norm
    return float(sums[8] / norm)


@inlined_part
def _multiply(matrix: _Float32, vector: FloatArray, out: FloatArray) -> None:
    """Fill out (6,) = matrix (6, 6) vector (6,)."""
    for j in range(6):
        out[j] = 0.0
        for k in range(6):
            out[j] += matrix[j, k] * vector[k]


@inlined_part
def _compose(uv: FloatArray, warp: FloatArray, step: FloatArray) -> bool:
    """Inverse composition, in place: warp <- warp (I + A)⁻¹, uv <- uv - warp b; False where
    I + A is singular. `step` (6,) is b and the rows of A times the radius."""
    c00, c01 = 1.0 + step[2] / RADIUS, step[3] / RADIUS
    c10, c11 = step[4] / RADIUS, 1.0 + step[5] / RADIUS
    det = c00 * c11 - c01 * c10
    if abs(det) < 1e-6:
        return False
    w00, w01, w10, w11 = warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1]
    warp[0, 0] = (w00 * c11 - w01 * c10) / det
    warp[0, 1] = (w01 * c00 - w00 * c01) / det
    warp[1, 0] = (w10 * c11 - w11 * c10) / det
    warp[1, 1] = (w11 * c00 - w10 * c01) / det
    uv[0] -= warp[0, 0] * step[0] + warp[0, 1] * step[1]
    uv[1] -= warp[1, 0] * step[0] + warp[1, 1] * step[1]
    return True


@part
def align_patch(
    words: Quads, patch: Patch, uv: FloatArray, warp: FloatArray, room: Room,
    most_steps: int, small_step: float,
) -> float:  # fmt: skip
    """Move `uv` (2,) and `warp` (2, 2), in place, to where a patch fits; the correlation there.

    `words`: the image, see `preprocessing.patch_image`. It stops after `most_steps`, where the
    shifts still to come are below `small_step`, as they fall by one factor from step to step,
    or `SIGMA_PX` from its start: the correlation is then 0, as it is where the warp is singular or
    leads out of the image.
    """
    start_u, start_v = uv[0], uv[1]
    correlation, step, before = 0.0, room.step, 0.0
    for _ in range(most_steps):
        correlation = _compare(words, uv[0], uv[1], warp, patch, room)
        if correlation < 0.0:
            return 0.0
        _multiply(patch.inverse, room.sums, step)
        if not _compose(uv, warp, step):
            return 0.0
        if not math.hypot(uv[0] - start_u, uv[1] - start_v) < SIGMA_PX:
            return 0.0
        size = max(abs(step[0]), abs(step[1]))
        if size <= small_step or size * size <= small_step * (before - size):
            break
        before = size
    return correlation


@part
def _cut_wide(words: Quads, u: float, v: float, wide: _Float32) -> None:
    """Grey levels wide (SIDE + 2, SIDE + 2) around (u, v); of the border beyond the margin."""
    size = SIDE + 2
    height, width = words.shape
    u = min(max(u + MARGIN, RADIUS + 1.0), width - RADIUS - 3.0)
    v = min(max(v + MARGIN, RADIUS + 1.0), height - RADIUS - 3.0)
    left, top = math.floor(u), math.floor(v)
    a, b = np.float32(u - left), np.float32(v - top)
    for i in range(size):
        row = words[top - RADIUS - 1 + i, left - RADIUS - 1 :]
        for j in range(size):
            word = row[j]
            here, right = np.float32(np.int32(word & 255)), np.float32(np.int32((word >> 8) & 255))
            below = np.float32(np.int32((word >> 16) & 255))
            diagonal = np.float32(np.int32((word >> 24) & 255))
            upper, lower = here + a * (right - here), below + a * (diagonal - below)
            wide[i, j] = upper + b * (lower - upper)


@reordered_part
def _make_unit(seen: _Float32) -> float:
    """Take off the weighted mean, weight, and divide by the norm, in place; that norm."""
    mean, square = np.float32(0.0), np.float32(0.0)
    for m in range(PADDED):
        mean += ROOT_WEIGHT[m] * ROOT_WEIGHT[m] * seen[m]
    for m in range(PADDED):
        seen[m] = ROOT_WEIGHT[m] * (seen[m] - mean)
        square += seen[m] * seen[m]
    norm = max(np.sqrt(square), np.float32(LEAST_NORM))
    scale = np.float32(1.0) / norm
    for m in range(PADDED):
        seen[m] *= scale
    return float(norm)


@part
def _differentiate(wide: _Float32, grey: _Float32, slope: _Float32) -> None:
    """The patch `grey` (PADDED,) inside the wide one, and its derivatives `slope` (2, PADDED)."""
    half = np.float32(0.5)
    grey[PIXELS:], slope[:, PIXELS:] = 0.0, 0.0
    for i in range(SIDE):
        for j in range(SIDE):
            m = i * SIDE + j
            grey[m] = wide[i + 1, j + 1]
            slope[0, m] = half * (wide[i + 1, j + 2] - wide[i + 1, j])
            slope[1, m] = half * (wide[i + 2, j + 1] - wide[i, j + 1])


@reordered_part
def _steepest(slope: _Float32, share: _Float32, out: _Float32) -> None:
    """A derivative (PADDED,) by a number of the warp: that by a shift times the pixel's place."""
    for m in range(PADDED):
        out[m] = slope[m] * share[m]


@reordered_part
def _without_gain(row: _Float32, grey: _Float32, gain: _Float32) -> None:
    """Take what an offset and a gain do off a derivative (PADDED,), in place; fill them (2,)."""
    mean, along = np.float32(0.0), np.float32(0.0)
    for m in range(PADDED):
        mean += ROOT_WEIGHT[m] * row[m]
    for m in range(PADDED):
        row[m] -= mean * ROOT_WEIGHT[m]
        along += row[m] * grey[m]
    for m in range(PADDED):
        row[m] -= along * grey[m]
    gain[0], gain[1] = mean, along


@reordered_part
def _weigh(row: _Float32, scale: float) -> None:
    """Weight and scale (PADDED,), in place."""
    factor = np.float32(scale)
    for m in range(PADDED):
        row[m] *= factor * ROOT_WEIGHT[m]


@reordered_part
def _dot(a: _Float32, b: _Float32) -> float:
    total = np.float32(0.0)
    for m in range(PADDED):
        total += a[m] * b[m]
    return float(total)


@part
def cut_patch(
    words: Quads, u: float, v: float, wide: _Float32, rows: _Float32, patch: Patch, damping: float
) -> None:
    """Fill a patch with that at (u, v) of an image.

    `wide` (SIDE + 2, SIDE + 2) and `rows` (6, PADDED) to work in. `damping`, a share of the mean
    curvature, keeps texture along one direction from running away along the other.
    """
    grey, slope, gain, inverse = patch
    _cut_wide(words, u, v, wide)
    _differentiate(wide, grey, slope)
    norm = _make_unit(grey)
    for k in range(2):
        _weigh(slope[k], 1.0 / norm)
        rows[k] = slope[k]
        _steepest(slope[k], _SHARE_U, rows[2 + 2 * k])
        _steepest(slope[k], _SHARE_V, rows[3 + 2 * k])
    for k in range(6):
        _without_gain(rows[k], grey, gain[k])
    H = np.empty((6, 6))
    trace = 0.0
    for i in range(6):
        for k in range(i + 1):
            H[i, k] = H[k, i] = _dot(rows[i], rows[k])
        trace += H[i, i]
    for i in range(6):
        H[i, i] += damping * trace / 6.0 + 1e-9
    invert_definite(H)
    for i in range(6):
        for k in range(6):
            inverse[i, k] = H[i, k]
