"""The compiled alignment of patches, point by point.

Alone in its file with all it calls, since compiled code is kept on disk under a hash of this file
(`kernel_cache`). It holds no Python lock. tests/frontend/test_patch_kernel.py holds its plain NumPy
twin.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import FloatArray, Image
from ovmot.kernel_cache import code_folder, compiled

_Float32 = npt.NDArray[np.float32]


def align_points(  # noqa: PLR0912, PLR0915 - one loop, compiled as a whole
    image: Image,
    grey: _Float32,
    steepest: _Float32,
    inverse: _Float32,
    root_weight: _Float32,
    uv: FloatArray,
    warp: FloatArray,
    max_steps: int,
    small_step: float,
    max_shift: float,
) -> FloatArray:
    """Move `uv` (N, 2) and `warp` (N, 2, 2), in place, to where the patches fit; correlation (N,).

    `grey` (N, M), `steepest` (N, M, 6), `inverse` (N, 6, 6) of M = side² pixels, row by row, as
    `patches.Patches` holds them; `root_weight` (M,). A point stops after `max_steps`, by a step
    below `small_step`, or `max_shift` pixels from its start.
    """
    n_points, n_pixels = grey.shape
    side = round(math.sqrt(n_pixels))
    radius = (side - 1) // 2
    height, width = image.shape
    correlation = np.zeros(n_points)
    seen = np.empty(n_pixels)
    gradient, step = np.empty(6), np.empty(6)
    for n in range(n_points):
        start_u, start_v = uv[n, 0], uv[n, 1]
        if not (math.isfinite(start_u) and math.isfinite(start_v)):
            continue
        for _ in range(max_steps):
            # grey levels at uv + warp x, the border carried on outwards
            total, weight_sum = 0.0, 0.0
            for row in range(side):
                for column in range(side):
                    x, y = float(column - radius), float(row - radius)
                    u = uv[n, 0] + warp[n, 0, 0] * x + warp[n, 0, 1] * y
                    v = uv[n, 1] + warp[n, 1, 0] * x + warp[n, 1, 1] * y
                    u = min(max(u, 0.0), width - 1.0)
                    v = min(max(v, 0.0), height - 1.0)
                    left, top = min(int(u), width - 2), min(int(v), height - 2)
                    a, b = u - left, v - top
                    above = (1.0 - a) * image[top, left] + a * image[top, left + 1]
                    below = (1.0 - a) * image[top + 1, left] + a * image[top + 1, left + 1]
                    m = row * side + column
                    seen[m] = (1.0 - b) * above + b * below
                    w = root_weight[m] * root_weight[m]
                    total += w * seen[m]
                    weight_sum += w
            mean = total / weight_sum
            square = 0.0
            for m in range(n_pixels):
                seen[m] = root_weight[m] * (seen[m] - mean)
                square += seen[m] * seen[m]
            norm = max(math.sqrt(square), 1e-3)
            # the error against the patch, and the Gauss-Newton step
            error_square = 0.0
            for k in range(6):
                gradient[k] = 0.0
            for m in range(n_pixels):
                error = seen[m] / norm - grey[n, m]
                error_square += error * error
                for k in range(6):
                    gradient[k] += error * steepest[n, m, k]
            correlation[n] = 1.0 - 0.5 * error_square
            largest = 0.0
            for j in range(6):
                step[j] = 0.0
                for k in range(6):
                    step[j] += inverse[n, j, k] * gradient[k]
                largest = max(largest, abs(step[j]))
            # warp <- warp (I + A)^-1, uv <- uv - warp b: the inverse composition
            c00, c01 = 1.0 + step[2] / radius, step[3] / radius
            c10, c11 = step[4] / radius, 1.0 + step[5] / radius
            det = c00 * c11 - c01 * c10
            if abs(det) < 1e-6:
                correlation[n] = 0.0
                break
            w00, w01, w10, w11 = warp[n, 0, 0], warp[n, 0, 1], warp[n, 1, 0], warp[n, 1, 1]
            warp[n, 0, 0] = (w00 * c11 - w01 * c10) / det
            warp[n, 0, 1] = (w01 * c00 - w00 * c01) / det
            warp[n, 1, 0] = (w10 * c11 - w11 * c10) / det
            warp[n, 1, 1] = (w11 * c00 - w10 * c01) / det
            uv[n, 0] -= warp[n, 0, 0] * step[0] + warp[n, 0, 1] * step[1]
            uv[n, 1] -= warp[n, 1, 0] * step[0] + warp[n, 1, 1] * step[1]
            away = math.hypot(uv[n, 0] - start_u, uv[n, 1] - start_v)
            if not away < max_shift or largest <= small_step:
                break
    return correlation


align_points_compiled = compiled(align_points, code_folder(Path(__file__)))
