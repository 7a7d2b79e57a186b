"""Compiled work on single patches: cut one from an image, align one with an image.

Called by kernels only; arrays are filled in place. A patch has `PIXELS` pixels by rows, in arrays
of `PADDED`: a loop over all of them then runs in SIMD lanes without a rest, and what lies beyond
the patch has no weight. `tests/frontend/test_patch_kernel.py` holds the plain NumPy twins.
"""

import math

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import part, reordered_part
from ovmot.kernels.small_matrices import invert_definite

_Float32 = npt.NDArray[np.float32]

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
_SHIFT = 64
"""Added to pixels relative to the patch's centre: what is cut off to a whole number is positive."""


def _padded(values: FloatArray) -> _Float32:
    return np.pad(values.ravel(), (0, PADDED - PIXELS)).astype(np.float32)


_row, _column = np.mgrid[-RADIUS : RADIUS + 1, -RADIUS : RADIUS + 1].astype(np.float64)
OFFSET_U, OFFSET_V = _padded(_column), _padded(_row)
ROOT_WEIGHT = _padded(np.exp(-0.25 * (_column**2 + _row**2) / SIGMA_PX**2))
"""Square root of a Gaussian weight: what lies off the centre counts less, since at an outline it
belongs to another body."""
WEIGHT = ROOT_WEIGHT**2 / (ROOT_WEIGHT**2).sum()


@reordered_part
def _sample(image: _Float32, u: float, v: float, warp: FloatArray, seen: _Float32) -> None:
    """Grey levels `seen` (PADDED,) at (u, v) + warp x of all offsets x, all in the image.

    The columns and rows are taken relative to the centre's, so that single precision is enough.
    """
    pixels, stride = image.ravel(), image.shape[1]
    left, top = math.floor(u), math.floor(v)
    corner = (top - _SHIFT) * stride + left - _SHIFT
    u0, v0 = np.float32(u - left + _SHIFT), np.float32(v - top + _SHIFT)
    w00, w01 = np.float32(warp[0, 0]), np.float32(warp[0, 1])
    w10, w11 = np.float32(warp[1, 0]), np.float32(warp[1, 1])
    right, below, diagonal = np.uint64(1), np.uint64(stride), np.uint64(stride + 1)
    for m in range(PADDED):
        x = u0 + w00 * OFFSET_U[m] + w01 * OFFSET_V[m]
        y = v0 + w10 * OFFSET_U[m] + w11 * OFFSET_V[m]
        column, row = np.int32(x), np.int32(y)
        a, b = x - np.float32(column), y - np.float32(row)
        k = np.uint64(corner + row * stride + column)
        upper = pixels[k] + a * (pixels[k + right] - pixels[k])
        lower = pixels[k + below] + a * (pixels[k + diagonal] - pixels[k + below])
        seen[m] = upper + b * (lower - upper)


@part
def _grey_at(image: _Float32, u: float, v: float) -> float:
    """Bilinear grey level, the image continued outwards by its border pixels."""
    height, width = image.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    left, top = min(int(u), width - 2), min(int(v), height - 2)
    a, b = u - left, v - top
    upper = (1.0 - a) * image[top, left] + a * image[top, left + 1]
    lower = (1.0 - a) * image[top + 1, left] + a * image[top + 1, left + 1]
    return float((1.0 - b) * upper + b * lower)


@part
def _sample_at_border(
    image: _Float32, u: float, v: float, warp: FloatArray, seen: _Float32
) -> None:
    """The same where the patch reaches beyond the image."""
    for m in range(PIXELS):
        x = u + warp[0, 0] * OFFSET_U[m] + warp[0, 1] * OFFSET_V[m]
        y = v + warp[1, 0] * OFFSET_U[m] + warp[1, 1] * OFFSET_V[m]
        seen[m] = _grey_at(image, x, y)
    seen[PIXELS:] = 0.0


@part
def _in_image(image: _Float32, u: float, v: float, warp: FloatArray) -> bool:
    """Does the whole warped patch lie in the image, and is it no larger than `_sample` can take?"""
    reach_u = (abs(warp[0, 0]) + abs(warp[0, 1])) * RADIUS + 1.0
    reach_v = (abs(warp[1, 0]) + abs(warp[1, 1])) * RADIUS + 1.0
    height, width = image.shape
    across: bool = reach_u < _SHIFT and reach_u <= u < width - 1 - reach_u
    return across and reach_v < _SHIFT and reach_v <= v < height - 1 - reach_v


@reordered_part
def _make_unit(seen: _Float32) -> float:
    """Take off the weighted mean, weight, and divide by the norm, in place; that norm."""
    mean, square = np.float32(0.0), np.float32(0.0)
    for m in range(PADDED):
        mean += WEIGHT[m] * seen[m]
    for m in range(PADDED):
        seen[m] = ROOT_WEIGHT[m] * (seen[m] - mean)
        square += seen[m] * seen[m]
    norm = max(np.sqrt(square), np.float32(LEAST_NORM))
    scale = np.float32(1.0) / norm
    for m in range(PADDED):
        seen[m] *= scale
    return float(norm)


@reordered_part
def _subtract(seen: _Float32, grey: _Float32) -> float:
    """Take `grey` off `seen` (PADDED,), in place; the squared norm of what is left."""
    square = np.float32(0.0)
    for m in range(PADDED):
        seen[m] -= grey[m]
        square += seen[m] * seen[m]
    return float(square)


@reordered_part
def _gradient(error: _Float32, steepest: _Float32, out: FloatArray) -> None:
    """out (6,) = steepest (6, PADDED) error (PADDED,)."""
    s0, s1, s2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    s3, s4, s5 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for m in range(PADDED):
        s0 += error[m] * steepest[0, m]
        s1 += error[m] * steepest[1, m]
        s2 += error[m] * steepest[2, m]
        s3 += error[m] * steepest[3, m]
        s4 += error[m] * steepest[4, m]
        s5 += error[m] * steepest[5, m]
    out[0], out[1], out[2], out[3], out[4], out[5] = s0, s1, s2, s3, s4, s5


@part
def _multiply(matrix: _Float32, vector: FloatArray, out: FloatArray) -> float:
    """Fill out (6,) = matrix (6, 6) vector (6,); its largest absolute number."""
    largest = 0.0
    for j in range(6):
        out[j] = 0.0
        for k in range(6):
            out[j] += matrix[j, k] * vector[k]
        largest = max(largest, abs(out[j]))
    return largest


@part
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
    image: _Float32, grey: _Float32, steepest: _Float32, inverse: _Float32,
    uv: FloatArray, warp: FloatArray, room: _Float32, most_steps: int, small_step: float,
) -> float:  # fmt: skip
    """Move `uv` (2,) and `warp` (2, 2), in place, to where a patch fits; the correlation there.

    `grey` (PADDED,), `steepest` (6, PADDED), `inverse` (6, 6) of the patch as `cut_patch` makes
    them, `room` (PADDED,) to work in. It stops after `most_steps`, by a step below `small_step`, or
    `SIGMA_PX` from its start: the correlation is then 0, as it is where the warp is singular.
    """
    start_u, start_v = uv[0], uv[1]
    gradient, step = np.empty(6), np.empty(6)
    correlation = 0.0
    for _ in range(most_steps):
        if _in_image(image, uv[0], uv[1], warp):
            _sample(image, uv[0], uv[1], warp, room)
        else:
            _sample_at_border(image, uv[0], uv[1], warp, room)
        _make_unit(room)
        correlation = 1.0 - 0.5 * _subtract(room, grey)
        _gradient(room, steepest, gradient)
        largest = _multiply(inverse, gradient, step)
        if not _compose(uv, warp, step):
            return 0.0
        if not math.hypot(uv[0] - start_u, uv[1] - start_v) < SIGMA_PX:
            return 0.0
        if largest <= small_step:
            break
    return correlation


@part
def _cut_wide(image: _Float32, u: float, v: float, wide: _Float32) -> None:
    """Grey levels wide (SIDE + 2, SIDE + 2) around (u, v)."""
    reach, size = RADIUS + 1, SIDE + 2
    left, top = math.floor(u) - reach, math.floor(v) - reach
    height, width = image.shape
    if left >= 0 and top >= 0 and left + size < width and top + size < height:
        a, b = np.float32(u - math.floor(u)), np.float32(v - math.floor(v))
        for i in range(size):
            row, below = image[top + i, left:], image[top + i + 1, left:]
            for j in range(size):
                upper = row[j] + a * (row[j + 1] - row[j])
                lower = below[j] + a * (below[j + 1] - below[j])
                wide[i, j] = upper + b * (lower - upper)
    else:
        for i in range(size):
            for j in range(size):
                wide[i, j] = _grey_at(image, u - reach + j, v - reach + i)


@part
def _differentiate(wide: _Float32, grey: _Float32, steepest: _Float32) -> None:
    """The patch `grey` (PADDED,) inside the wide one, and its derivatives `steepest` (6, PADDED) by
    a shift and by the warp's four numbers times the radius."""
    half = np.float32(0.5)
    grey[PIXELS:], steepest[:, PIXELS:] = 0.0, 0.0
    for i in range(SIDE):
        for j in range(SIDE):
            m = i * SIDE + j
            grey[m] = wide[i + 1, j + 1]
            by_u = half * (wide[i + 1, j + 2] - wide[i + 1, j])
            by_v = half * (wide[i + 2, j + 1] - wide[i, j + 1])
            x, y = OFFSET_U[m] / np.float32(RADIUS), OFFSET_V[m] / np.float32(RADIUS)
            steepest[0, m], steepest[1, m] = by_u, by_v
            steepest[2, m], steepest[3, m] = by_u * x, by_u * y
            steepest[4, m], steepest[5, m] = by_v * x, by_v * y


@reordered_part
def _without_gain(row: _Float32, grey: _Float32, norm: float) -> None:
    """A derivative (PADDED,) of the unit patch, in place: without what a gain or an offset does."""
    scale, mean, along = np.float32(1.0 / norm), np.float32(0.0), np.float32(0.0)
    for m in range(PADDED):
        mean += WEIGHT[m] * row[m]
    for m in range(PADDED):
        row[m] = scale * ROOT_WEIGHT[m] * (row[m] - mean)
        along += row[m] * grey[m]
    for m in range(PADDED):
        row[m] -= along * grey[m]


@reordered_part
def _dot(a: _Float32, b: _Float32) -> float:
    total = np.float32(0.0)
    for m in range(PADDED):
        total += a[m] * b[m]
    return float(total)


@part
def cut_patch(
    image: _Float32, u: float, v: float, wide: _Float32,
    grey: _Float32, steepest: _Float32, inverse: _Float32, damping: float,
) -> None:  # fmt: skip
    """Fill `grey` (PADDED,), `steepest` (6, PADDED), `inverse` (6, 6) with the patch at (u, v).

    `wide` (SIDE + 2, SIDE + 2) to work in. `damping`, a share of the mean curvature, keeps texture
    along one direction from running away along the other.
    """
    _cut_wide(image, u, v, wide)
    _differentiate(wide, grey, steepest)
    norm = _make_unit(grey)
    for k in range(6):
        _without_gain(steepest[k], grey, norm)
    H = np.empty((6, 6))
    trace = 0.0
    for i in range(6):
        for k in range(i + 1):
            H[i, k] = H[k, i] = _dot(steepest[i], steepest[k])
        trace += H[i, i]
    for i in range(6):
        H[i, i] += damping * trace / 6.0 + 1e-9
    invert_definite(H)
    for i in range(6):
        for k in range(6):
            inverse[i, k] = H[i, k]
