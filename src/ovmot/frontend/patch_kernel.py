"""The compiled alignment of patches, point by point.

It holds no Python lock. `tests/frontend/test_patch_kernel.py` holds its plain NumPy twin.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled, part, reordered_part

_Float32 = npt.NDArray[np.float32]
_SHIFT = 64
"""Added to pixels relative to the patch's centre: what is cut off to a whole number is positive."""


@reordered_part
def _sample(
    image: _Float32, u: float, v: float, warp: FloatArray, offsets: _Float32, seen: _Float32
) -> None:
    """Grey levels `seen` (M,) at (u, v) + warp x for `offsets` x (2, M), all in the image.

    The columns and rows are taken relative to the centre's, so that single precision is enough.
    """
    pixels, stride = image.ravel(), image.shape[1]
    left, top = math.floor(u), math.floor(v)
    corner = (top - _SHIFT) * stride + left - _SHIFT
    u0, v0 = np.float32(u - left + _SHIFT), np.float32(v - top + _SHIFT)
    w00, w01 = np.float32(warp[0, 0]), np.float32(warp[0, 1])
    w10, w11 = np.float32(warp[1, 0]), np.float32(warp[1, 1])
    one, right, below = np.float32(1.0), np.uint64(1), np.uint64(stride)
    by_x, by_y = offsets[0], offsets[1]
    for m in range(len(seen)):
        x = u0 + w00 * by_x[m] + w01 * by_y[m]
        y = v0 + w10 * by_x[m] + w11 * by_y[m]
        column, row = np.int32(x), np.int32(y)
        a, b = x - np.float32(column), y - np.float32(row)
        k = np.uint64(corner + row * stride + column)
        upper = (one - a) * pixels[k] + a * pixels[k + right]
        lower = (one - a) * pixels[k + below] + a * pixels[k + below + right]
        seen[m] = (one - b) * upper + b * lower


@reordered_part
def _sample_at_border(
    image: _Float32, u: float, v: float, warp: FloatArray, offsets: _Float32, seen: _Float32
) -> None:
    """The same, the image continued outwards by its border pixels."""
    height, width = image.shape
    for m in range(len(seen)):
        x = u + warp[0, 0] * offsets[0, m] + warp[0, 1] * offsets[1, m]
        y = v + warp[1, 0] * offsets[0, m] + warp[1, 1] * offsets[1, m]
        x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
        left, top = min(int(x), width - 2), min(int(y), height - 2)
        a, b = x - left, y - top
        upper = (1.0 - a) * image[top, left] + a * image[top, left + 1]
        lower = (1.0 - a) * image[top + 1, left] + a * image[top + 1, left + 1]
        seen[m] = (1.0 - b) * upper + b * lower


@reordered_part
def _in_image(image: _Float32, u: float, v: float, warp: FloatArray, radius: float) -> bool:
    """Does the whole warped patch lie in the image, and is it no larger than `_sample` can take?"""
    reach_u = (abs(warp[0, 0]) + abs(warp[0, 1])) * radius + 1.0
    reach_v = (abs(warp[1, 0]) + abs(warp[1, 1])) * radius + 1.0
    height, width = image.shape
    across: bool = reach_u < _SHIFT and reach_u <= u < width - 1 - reach_u
    return across and reach_v < _SHIFT and reach_v <= v < height - 1 - reach_v


@reordered_part
def _make_unit(seen: _Float32, root_weight: _Float32) -> None:
    """Take off the weighted mean, weight, and divide by the norm, in place."""
    total, weight_sum, square = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for m in range(len(seen)):
        weight = root_weight[m] * root_weight[m]
        total += weight * seen[m]
        weight_sum += weight
    mean = total / weight_sum
    for m in range(len(seen)):
        seen[m] = root_weight[m] * (seen[m] - mean)
        square += seen[m] * seen[m]
    scale = np.float32(1.0) / max(np.sqrt(square), np.float32(1e-3))
    for m in range(len(seen)):
        seen[m] *= scale


@reordered_part
def _dot(a: _Float32, b: _Float32) -> float:
    total = np.float32(0.0)
    for m in range(len(a)):
        total += a[m] * b[m]
    return float(total)


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
def _compose(uv: FloatArray, warp: FloatArray, step: FloatArray, radius: float) -> bool:
    """Inverse composition, in place: warp <- warp (I + A)⁻¹, uv <- uv - warp b; False where
    I + A is singular. `step` (6,) is b and the rows of A times the radius."""
    c00, c01 = 1.0 + step[2] / radius, step[3] / radius
    c10, c11 = step[4] / radius, 1.0 + step[5] / radius
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


def align_points(
    image: _Float32,
    grey: _Float32,
    steepest: _Float32,
    inverse: _Float32,
    root_weight: _Float32,
    offsets: _Float32,
    uv: FloatArray,
    warp: FloatArray,
    max_steps: int,
    small_step: float,
    max_shift: float,
) -> FloatArray:
    """Move `uv` (N, 2) and `warp` (N, 2, 2), in place, to where the patches fit; correlation (N,).

    `grey` (N, M), `steepest` (N, 6, M), `inverse` (N, 6, 6) as `patches.Patches` holds them;
    `root_weight` (M,) and `offsets` (2, M) of their pixels. A point stops after `max_steps`, by a
    step below `small_step`, or `max_shift` pixels from its start.
    """
    n_points, n_pixels = grey.shape
    radius = float(offsets.max())
    correlation = np.zeros(n_points)
    error = np.empty(n_pixels, dtype=np.float32)
    gradient, step = np.empty(6), np.empty(6)
    for n in range(n_points):
        start_u, start_v = uv[n, 0], uv[n, 1]
        if not (math.isfinite(start_u) and math.isfinite(start_v)):
            continue
        for _ in range(max_steps):
            # the error against the patch, and the Gauss-Newton step
            if _in_image(image, uv[n, 0], uv[n, 1], warp[n], radius):
                _sample(image, uv[n, 0], uv[n, 1], warp[n], offsets, error)
            else:
                _sample_at_border(image, uv[n, 0], uv[n, 1], warp[n], offsets, error)
            _make_unit(error, root_weight)
            for m in range(n_pixels):
                error[m] -= grey[n, m]
            correlation[n] = 1.0 - 0.5 * _dot(error, error)
            for k in range(6):
                gradient[k] = _dot(error, steepest[n, k])
            largest = _multiply(inverse[n], gradient, step)
            if not _compose(uv[n], warp[n], step, radius):
                correlation[n] = 0.0
                break
            away = math.hypot(uv[n, 0] - start_u, uv[n, 1] - start_v)
            if not away < max_shift or largest <= small_step:
                break
    return correlation


align_points_compiled = compiled(align_points, code_folder(Path(__file__)))
