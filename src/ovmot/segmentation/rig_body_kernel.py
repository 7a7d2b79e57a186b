"""The compiled question which features stand in the picture although what is at rest moves."""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part

STANDS, EXPECTED, MOVES = 3.0, 10.0, 6.0
"""Sigmas: a way in the picture that is none; one that rest would have to make; one that is one."""


@part
def _expected_way(
    x: float, y: float, p: FloatArray, T: FloatArray, focal: float, reach: float
) -> float:
    """How far a point at rest moves in the picture, pixels: infinite where the rig has passed it
    by, NaN beyond the `reach`. (x, y): where it was, normalized; `p` (3,): metres, NaN where
    unknown: then by the rotation alone; T (4, 4) maps points of then into the camera of now."""
    known = math.isfinite(p[2])
    if known and p[2] >= reach:
        return math.nan
    a, b, c, w = (p[0], p[1], p[2], 1.0) if known else (x, y, 1.0, 0.0)
    u = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3] * w
    v = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3] * w
    depth = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] * w
    if not depth > 0.0:
        return math.inf
    return focal * math.hypot(u / depth - x, v / depth - y)


def find_standing(
    then: FloatArray, p_then: FloatArray, now: FloatArray, T_now_then: FloatArray,
    sigma_px: FloatArray, focal: float, reach: float,
) -> tuple[BoolArray, BoolArray]:  # fmt: skip
    """Which features (N,) stand, and which move, by the oldest frame that saw them.

    `then` (L, N, 4), `now` (N, 4): normalized coordinates, NaN where unseen; `p_then` (L, N, 3),
    metres; `T_now_then` (L, 4, 4) of the left camera; `sigma_px` (L,): of a way that is none;
    `focal` in pixels; `reach`, metres: points beyond do not stand.
    """
    n_rows, n_features = then.shape[0], then.shape[1]
    stands, moves = np.zeros(n_features, dtype=np.bool_), np.zeros(n_features, dtype=np.bool_)
    for n in range(n_features):
        for k in range(n_rows):
            x, y = then[k, n, 0], then[k, n, 1]
            if not math.isfinite(x):
                continue
            way = focal * math.hypot(now[n, 0] - x, now[n, 1] - y)
            moves[n] = way > MOVES * sigma_px[k]
            if way < STANDS * sigma_px[k]:
                off = _expected_way(x, y, p_then[k, n], T_now_then[k], focal, reach)
                stands[n] = off > EXPECTED * sigma_px[k]
            break
    return stands, moves


def count_in_cells(
    pixels: FloatArray, side: int, stands: BoolArray, moves: BoolArray,
    cell_px: int, width: int, height: int, stood: IntArray, moved: IntArray,
) -> tuple[IntArray, IntArray]:  # fmt: skip
    """The counts `stood` and `moved` (rows, columns) with a frame's features, in new arrays.

    `pixels` (N, 4), of `side` 0 in the left picture, 1 in the right one, both of size (height,
    width), in square cells of `cell_px`; which features stand and which move (N,).
    """
    more_stood, more_moved = stood.copy(), moved.copy()
    for n in range(len(pixels)):
        u, v = pixels[n, 2 * side], pixels[n, 2 * side + 1]
        if 0.0 <= u < width and 0.0 <= v < height:
            row, column = int(v) // cell_px, int(u) // cell_px
            more_stood[row, column] += stands[n]
            more_moved[row, column] += moves[n]
    return more_stood, more_moved


_folder = code_folder(Path(__file__))
find_standing_compiled = compiled(find_standing, _folder)
count_in_cells_compiled = compiled(count_in_cells, _folder)
