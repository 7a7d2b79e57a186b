"""Compiled choice of observations from the feature table.

tests/vio/test_window_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled


def available_views(
    pixels: FloatArray, used: BoolArray, dynamic: BoolArray, rows: BoolArray
) -> BoolArray:
    """Observations (T, F) in `rows` (T,) by either camera, not `used` (T, F), not `dynamic` (F,).

    `pixels` (T, F, 4): NaN where unseen.
    """
    out = np.zeros(used.shape, dtype=np.bool_)
    for t in range(len(used)):
        if rows[t]:
            for f in range(used.shape[1]):
                seen = math.isfinite(pixels[t, f, 0]) or math.isfinite(pixels[t, f, 2])
                out[t, f] = seen and not (used[t, f] or dynamic[f])
    return out


def gather_views(
    pixels: FloatArray, normalized: FloatArray, available: BoolArray, column: IntArray,
    row: IntArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Pixels and normalized coordinates (n, K, 4) of features (n,) at K rows; NaN elsewhere.

    `pixels`, `normalized` (T, F, 4); `available` (T, F): what may be taken; `row` (K,): -1 for
    none.
    """
    out = np.full((2, len(column), len(row), 4), np.nan)
    for n in range(len(column)):
        for k in range(len(row)):
            t, f = row[k], column[n]
            if t >= 0 and available[t, f]:
                for i in range(4):
                    out[0, n, k, i] = pixels[t, f, i]
                    out[1, n, k, i] = normalized[t, f, i]
    return out[0], out[1]


_FOLDER = code_folder(Path(__file__))
available_views_compiled = compiled(available_views, _FOLDER)
gather_views_compiled = compiled(gather_views, _FOLDER)
