"""Arrays as lists that JSON can hold, no longer than a page needs."""

from math import isfinite
from typing import Any

import numpy as np

from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray


def grid(n: int, most: int) -> IntArray:
    """Indices of at most so many of n samples, the first and the last among them."""
    if n <= most:
        return np.arange(n)
    return np.unique(np.linspace(0, n - 1, most).round().astype(np.int64))


def listed(values: AnyArray, digits: int) -> list[Any]:
    """Numbers rounded to so many decimals, None where one is not finite; nested for 2-D arrays."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1:
        return [listed(row, digits) for row in array]
    return [x if isfinite(x) else None for x in array.round(digits).tolist()]


def number(value: float, digits: int) -> float | None:
    """A number rounded to so many decimals, None where it is not finite."""
    return round(float(value), digits) if np.isfinite(value) else None


def spans(seconds: FloatArray, where: BoolArray) -> list[list[float]]:
    """The intervals (first, last) in seconds (N,) over which a condition (N,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    return [
        [round(float(seconds[a]), 3), round(float(seconds[b - 1]), 3)]
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
