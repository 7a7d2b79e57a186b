"""Compiled work on the arrays of the feature table: find, choose, gather, count.

tests/kernels/test_table_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2⁶⁴ over the golden ratio, odd


def columns_of(ids: IntArray, among: IntArray) -> IntArray:
    """Where each id (N,) stands first in an array of ids (n,) in any order; -1 for none.

    A hash table with linear probing; Fibonacci hashing (D. Knuth, TAOCP vol. 3, sec. 6.4).
    """
    size, shift = 4, 62
    while size < 2 * len(among):
        size, shift = 2 * size, shift - 1
    slots, out = np.full(size, -1, np.int64), np.full(len(ids), -1, np.int64)
    for n in range(len(among)):
        slot = np.int64((np.uint64(among[n]) * _GOLDEN) >> np.uint64(shift))
        while slots[slot] >= 0:
            slot = (slot + 1) % size
        slots[slot] = n
    for n in range(len(ids)):
        slot = np.int64((np.uint64(ids[n]) * _GOLDEN) >> np.uint64(shift))
        while slots[slot] >= 0:
            if among[slots[slot]] == ids[n]:
                out[n] = slots[slot]
                break
            slot = (slot + 1) % size
    return out


rows_of_ids = part(columns_of)
"""`columns_of` for other kernels."""


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
                if not (used[t, f] or dynamic[f]):
                    out[t, f] = math.isfinite(pixels[t, f, 0]) or math.isfinite(pixels[t, f, 2])
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


def live_columns(
    pixels: FloatArray, used: BoolArray, dynamic: BoolArray, row: IntArray
) -> BoolArray:
    """Columns (F,) that the newest of the rows (n,) sees, or in which one is fresh.

    `pixels` (T, F, 4), `used` (T, F), `dynamic` (F,); fresh is a view of either camera, not used,
    of a feature that is not dynamic.
    """
    out = np.zeros(used.shape[1], dtype=np.bool_)
    for f in range(len(out)):
        for k in range(len(row) - 1, -1, -1):  # most are seen by the newest
            t = row[k]
            if k == len(row) - 1 or not used[t, f]:
                out[f] = math.isfinite(pixels[t, f, 0]) or math.isfinite(pixels[t, f, 2])
            if out[f] or dynamic[f]:
                break
    return out


def count_still(
    earlier: FloatArray, now: FloatArray, column: IntArray, max_pixels: float
) -> tuple[int, int]:
    """How many features of some columns (n,) two rows see, and how many moved less than a bound.

    `earlier`, `now` (F, 4): pixels, NaN where unseen; compared are those of `types.tracked_pixels`.
    """
    n_both, n_still = 0, 0
    for n in range(len(column)):
        a, b = earlier[column[n]], now[column[n]]
        i, j = 2 if math.isnan(a[0]) else 0, 2 if math.isnan(b[0]) else 0
        way = math.hypot(b[j] - a[i], b[j + 1] - a[i + 1])
        n_both += math.isfinite(way)
        n_still += way < max_pixels
    return n_both, n_still


_FOLDER = code_folder(Path(__file__))
columns_of_compiled = compiled(columns_of, _FOLDER)
live_columns_compiled = compiled(live_columns, _FOLDER)
available_views_compiled = compiled(available_views, _FOLDER)
gather_views_compiled = compiled(gather_views, _FOLDER)
count_still_compiled = compiled(count_still, _FOLDER)
