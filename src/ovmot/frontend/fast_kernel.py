"""Compiled FAST corners (E. Rosten & T. Drummond, ECCV 2006), sought only where they are wanted.

A corner of FAST-9 has nine neighbours in a row, on a circle of 16, that are all brighter or all
darker than it by more than a threshold; its strength is the greatest threshold at which it is still
one. It must be stronger than the eight pixels around it. Most pixels fail on the diameters of the
circle. All loops run in SIMD lanes, over the pixels of a row or over a number of candidates.
`tests/frontend/test_fast_kernel.py` compares with OpenCV's detector, which looks everywhere, and
makes a Python object of each corner.
"""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part

_RING_U = np.array([0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1])
_RING_V = np.array([3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1, 0, 1, 2, 3])
_REACH = 3
"""Radius of the circle in pixels."""
_WORD = 8
"""Pixels whose flags are looked at together."""
_PORTION = 128
"""Candidates measured together: what is known of them stays in the fastest memory."""

_Number = int | np.integer[Any]
_Lanes = npt.NDArray[np.int16]
_Bytes = npt.NDArray[np.uint8]


@inlined_part
def _least(a: _Number, b: _Number) -> _Number:
    """The lesser one, of their own type: `min` would widen it."""
    return a if a < b else b


@inlined_part
def _most(a: _Number, b: _Number) -> _Number:
    return a if a > b else b


@part
def _flag_row(
    up: tuple[Image, Image, Image], row: Image, down: tuple[Image, Image, Image],
    room: tuple[Image, Image, Image], threshold: int, flags: _Bytes,
) -> None:  # fmt: skip
    """Flag (width - 6,) the pixels of a row, from the fourth one on, that may be corners.

    `up`, `down`: the rows at distances 1 to 3. Nine in a row of 16 hold an end of each diameter:
    the least of the brighter ends is brighter than the pixel, or the greatest of the darker ones is
    darker. `room`: its rows above, here and below; a pixel is in it or beside it.
    """
    above, here, below = room
    u1, u2, u3 = up
    d1, d2, d3 = down
    zero, white, t = np.int16(0), np.int16(255), np.int16(threshold)
    for u in range(len(row) - 2 * _REACH):
        centre = np.int16(row[u + 3])
        low, high = np.uint8(max(centre - t, zero)), np.uint8(min(centre + t, white))
        bright, dark = _most(u3[u + 3], d3[u + 3]), _least(u3[u + 3], d3[u + 3])
        bright = _least(bright, _most(u3[u + 4], d3[u + 2]))
        dark = _most(dark, _least(u3[u + 4], d3[u + 2]))
        bright = _least(bright, _most(u2[u + 5], d2[u + 1]))
        dark = _most(dark, _least(u2[u + 5], d2[u + 1]))
        bright = _least(bright, _most(u1[u + 6], d1[u]))
        dark = _most(dark, _least(u1[u + 6], d1[u]))
        bright = _least(bright, _most(row[u + 6], row[u]))
        dark = _most(dark, _least(row[u + 6], row[u]))
        bright = _least(bright, _most(d1[u + 6], u1[u]))
        dark = _most(dark, _least(d1[u + 6], u1[u]))
        bright = _least(bright, _most(d2[u + 5], u2[u + 1]))
        dark = _most(dark, _least(d2[u + 5], u2[u + 1]))
        bright = _least(bright, _most(d3[u + 4], u3[u + 2]))
        dark = _most(dark, _least(d3[u + 4], u3[u + 2]))
        near = above[u + 2] | above[u + 3] | above[u + 4] | here[u + 2] | here[u + 3]
        near = near | here[u + 4] | below[u + 2] | below[u + 3] | below[u + 4]
        flags[u] = np.uint8(((bright > high) | (dark < low)) & (near != 0))


@part
def _candidates(image: Image, room: Image, threshold: int) -> IntArray:
    """Pixels (K,), in an image of one line, that may be corners, in the room or beside it."""
    height, width = image.shape
    flags, count = np.zeros(-(-width // _WORD), dtype=np.int64), 0
    flag, found = flags.view(np.uint8), np.empty(image.size + _WORD, dtype=np.int64)
    for v in range(_REACH, height - _REACH):
        _flag_row(
            (image[v - 1], image[v - 2], image[v - 3]), image[v],
            (image[v + 1], image[v + 2], image[v + 3]),
            (room[v - 1], room[v], room[v + 1]), threshold, flag,
        )  # fmt: skip
        for word in range(len(flags)):
            if flags[word] != 0:
                for k in range(word * _WORD, (word + 1) * _WORD):
                    found[count] = v * width + k + _REACH  # kept where it is flagged
                    count += flag[k]
    return found[:count]


@part
def _least_apart(source: _Lanes, apart: int, out: _Lanes) -> None:
    """Of rows k and k + `apart` modulo 16 the lesser values (16, n)."""
    for k in range(16):
        a, b, lesser = source[k], source[(k + apart) % 16], out[k]
        for n in range(_PORTION):
            lesser[n] = _least(a[n], b[n])


@part
def _most_apart(source: _Lanes, apart: int, out: _Lanes) -> None:
    """The greater ones."""
    for k in range(16):
        a, b, greater = source[k], source[(k + apart) % 16], out[k]
        for n in range(_PORTION):
            greater[n] = _most(a[n], b[n])


@part
def _measure(pixels: _Bytes, at: IntArray, ring: IntArray, lanes: _Lanes, strength: _Lanes) -> None:
    """Fill the strengths of candidates `at` (n,), at most `_PORTION`, of an image in one line.

    `ring` (16,): where their neighbours are, counted from them. `lanes` (5, 16, `_PORTION`): memory
    to work in. The least and the greatest difference of each arc of nine come from those of arcs
    of 2, 4 and 8.
    """
    off, least, most, low, high = lanes[0], lanes[1], lanes[2], lanes[3], lanes[4]
    for n in range(len(at)):
        centre = np.int16(pixels[at[n]])
        for k in range(16):
            off[k, n] = np.int16(np.int16(pixels[at[n] + ring[k]]) - centre)
    _least_apart(off, 1, least)
    _most_apart(off, 1, most)
    _least_apart(least, 2, low)
    _most_apart(most, 2, high)
    _least_apart(low, 4, least)
    _most_apart(high, 4, most)
    strength[:] = 0
    for k in range(16):
        bright, dark, last = least[k], most[k], off[(k + 8) % 16]
        for n in range(_PORTION):
            brighter, darker = _least(bright[n], last[n]), _most(dark[n], last[n])
            strength[n] = _most(strength[n], _most(brighter, np.int16(-darker)))
    for n in range(_PORTION):
        strength[n] -= np.int16(1)


@inlined_part
def _is_strongest(strength: _Bytes, at: int, width: int) -> bool:
    """Is a corner stronger than the eight pixels around it?"""
    here = strength[at]
    for row in (at - width, at, at + width):
        for place in (row - 1, row, row + 1):
            if place != at and strength[place] >= here:
                return False
    return True


def fast_corners(image: Image, room: Image, threshold: int, border_px: int) -> FloatArray:
    """All corners (M, 2) of an image (height, width), the strongest first, equal ones by rows.

    Where `room` (height, width) is not zero, and at least `border_px` from the border. `threshold`,
    at least 1, in grey levels.
    """
    height, width = image.shape
    pixels, at = image.ravel(), _candidates(image, room, threshold)
    ring, lanes = _RING_V * width + _RING_U, np.zeros((5, 16, _PORTION), dtype=np.int16)
    strength, measured = np.zeros(image.size, dtype=np.uint8), np.empty(_PORTION, dtype=np.int16)
    for first in range(0, len(at), _PORTION):
        portion = at[first : first + _PORTION]
        _measure(pixels, portion, ring, lanes, measured)
        for n in range(len(portion)):
            if measured[n] >= threshold:
                strength[portion[n]] = measured[n]
    count, starts, wanted = 0, np.zeros(257, dtype=np.int64), room.ravel()
    for place in at:
        if strength[place] == 0 or wanted[place] == 0:
            continue
        v, u = place // width, place % width
        inside = border_px <= u < width - border_px and border_px <= v < height - border_px
        if inside and _is_strongest(strength, place, width):
            at[count] = place
            starts[256 - strength[place]] += 1  # counting sort: where those of it begin
            count += 1
    for k in range(1, 257):
        starts[k] += starts[k - 1]
    out = np.empty((count, 2))
    for place in at[:count]:
        rank = starts[255 - strength[place]]
        out[rank, 0], out[rank, 1] = place % width, place // width
        starts[255 - strength[place]] += 1
    return out


fast_corners_compiled = compiled(fast_corners, code_folder(Path(__file__)))
