"""Compiled passes over whole images: one gain for all grey levels, and the image of patches.

Both are loops over rows that run in SIMD lanes. The plain twins are in
`tests/frontend/test_image_kernel.py`.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import BoolArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled, part

_Words = npt.NDArray[np.int32]
_BITS = 8
"""Of the weights of smoothing: their sum is 2⁸, as in OpenCV's fixed point."""


def grey_range(image: Image, step: int, low: float, high: float) -> tuple[float, float]:
    """Percentiles `low` and `high`, in percent, of the grey levels of every `step`-th row and
    column: the values of `numpy.percentile`, by counting levels in place of sorting pixels."""
    counts = np.zeros(256, dtype=np.int64)
    for v in range(0, image.shape[0], step):
        row = image[v]
        for u in range(0, len(row), step):
            counts[row[u]] += 1
    return _percentile(counts, low), _percentile(counts, high)


def thin_out(
    image: Image, step: int, last: Image, low: float, high: float
) -> tuple[Image, BoolArray, float, float]:
    """Every `step`-th column of an image, in which rows (height,) it is `last`, and `grey_range`.

    `last`: that of another image, or an empty one (0, 0), which no row is equal to.
    """
    height, n_columns = image.shape[0], -(-image.shape[1] // step)
    thin, equal = np.empty((height, n_columns), np.uint8), np.zeros(height, np.bool_)
    counts = np.zeros(256, dtype=np.int64)
    for v in range(height):
        row, out = image[v], thin[v]
        for k in range(n_columns):
            out[k] = row[k * step]
        if v % step == 0:
            for k in range(n_columns):
                counts[out[k]] += 1
        if len(last):
            before, k = last[v], 0
            while k < n_columns and out[k] == before[k]:
                k += 1
            equal[v] = k == n_columns
    return thin, equal, _percentile(counts, low), _percentile(counts, high)


@part
def _percentile(counts: IntArray, percent: float) -> float:
    """A percentile by how often each level occurs (256,), interpolated between neighbours."""
    place = percent / 100.0 * (counts.sum() - 1)
    below, level, up_to = int(place), 0, counts[0]
    while up_to <= below:
        level += 1
        up_to += counts[level]
    above = level
    while up_to <= below + 1 and place > below:
        above += 1
        up_to += counts[above]
    return float(level + (place - below) * (above - level))


def scale_levels(image: Image, low: float, gain: float) -> Image:
    """Grey levels (g - low) gain of an image (height, width), cut off to 0 ... 255."""
    out = np.empty_like(image)
    zero, factor = np.float32(low), np.float32(gain)
    for v in range(len(image)):
        row, target = image[v], out[v]
        for u in range(len(row)):
            level = (np.float32(row[u]) - zero) * factor
            target[u] = np.uint8(np.int32(min(max(level, np.float32(0.0)), np.float32(255.0))))
    return out


@part
def _smooth_row(
    image: Image, v: int, weights: _Words, margin: int, sums: _Words, out: _Words
) -> None:
    """Fill `out` (width + 2 margin + 1,): row `v` smoothed by five weights both ways, with `margin`
    pixels of its ends. Rows and columns beyond the border are those mirrored at it."""
    height, width = image.shape
    last = height - 1
    up2, up1 = image[abs(v - 2)], image[abs(v - 1)]
    down1, down2 = image[last - abs(last - v - 1)], image[last - abs(last - v - 2)]
    here = image[v]
    w2, w1, w0 = weights[0], weights[1], weights[2]
    inner = sums[2 : width + 2]
    for u in range(width):
        inner[u] = (
            w2 * (np.int32(up2[u]) + np.int32(down2[u]))
            + w1 * (np.int32(up1[u]) + np.int32(down1[u])) + w0 * np.int32(here[u])
        )  # fmt: skip
    sums[0], sums[1] = inner[2], inner[1]
    sums[width + 2], sums[width + 3] = inner[width - 2], inner[width - 3]
    smooth = out[margin : margin + width]
    half = np.int32(1 << (2 * _BITS - 1))
    for u in range(width):
        total = w2 * (sums[u] + sums[u + 4]) + w1 * (sums[u + 1] + sums[u + 3]) + w0 * sums[u + 2]
        smooth[u] = np.int32(np.int32(total + half) >> np.int32(2 * _BITS))
    for u in range(margin):
        out[u] = smooth[0]
    for u in range(margin + width, len(out)):
        out[u] = smooth[width - 1]


@part
def _join(upper: _Words, lower: _Words, words: _Words) -> None:
    """Fill words (n,) of two rows (n + 1,): a pixel, its right, lower and lower right one."""
    for u in range(len(words)):
        words[u] = (
            upper[u] | (upper[u + 1] << np.int32(8))
            | (lower[u] << np.int32(16)) | (lower[u + 1] << np.int32(24))
        )  # fmt: skip


def smooth_to_words(image: Image, weights: _Words, margin: int) -> _Words:
    """Words (height + 2 margin, width + 2 margin) of a smoothed image (height, width), at least
    three pixels each way: see `preprocessing.patch_image`. `weights` (3,): the outer two, of five,
    and the middle one, of a sum of 256."""
    height, width = image.shape
    words = np.empty((height + 2 * margin, width + 2 * margin), dtype=np.int32)
    sums = np.empty(width + 4, dtype=np.int32)
    upper = np.empty(width + 2 * margin + 1, dtype=np.int32)
    lower = np.empty_like(upper)
    _smooth_row(image, 0, weights, margin, sums, lower)
    for row in range(margin):
        _join(lower, lower, words[row])
    for v in range(1, height):
        upper, lower = lower, upper
        _smooth_row(image, v, weights, margin, sums, lower)
        _join(upper, lower, words[margin + v - 1])
    for row in range(margin + height - 1, len(words)):
        _join(lower, lower, words[row])
    return words


_folder = code_folder(Path(__file__))
grey_range_compiled = compiled(grey_range, _folder)
thin_out_compiled = compiled(thin_out, _folder)
scale_levels_compiled = compiled(scale_levels, _folder)
smooth_to_words_compiled = compiled(smooth_to_words, _folder)
