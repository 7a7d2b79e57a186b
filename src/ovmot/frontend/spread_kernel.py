"""The compiled choice of corners that keep apart."""

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import part


@part
def _add_to_bin(u: float, v: float, side: float, bins: IntArray, k: int, after: IntArray) -> None:
    """Put feature `k` at (u, v) first in its bin; `after[k]` is the one that was first before."""
    row, column = int(v // side), int(u // side)
    if 0 <= row < bins.shape[0] and 0 <= column < bins.shape[1]:
        after[k] = bins[row, column]
        bins[row, column] = k


@part
def _is_free(
    u: float, v: float, distance: float, bins: IntArray, after: IntArray, taken: FloatArray
) -> bool:
    """Is no feature `taken` (K, 2) nearer than `distance`? Only the bins around can hold one."""
    row, column = int(v // distance), int(u // distance)
    for i in range(max(row - 1, 0), min(row + 2, bins.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, bins.shape[1])):
            k = bins[i, j]
            while k >= 0:
                if (taken[k, 0] - u) ** 2 + (taken[k, 1] - v) ** 2 < distance**2:
                    return False
                k = after[k]
    return True


@part
def _cell_of(u: float, v: float, side: int, rows: int, columns: int) -> int:
    """Index of the square cell around a pixel; that at the border for pixels outside."""
    column = min(max(int(u) // side, 0), columns - 1)
    row = min(max(int(v) // side, 0), rows - 1)
    return row * columns + column


@part
def spread_corners(
    corners: FloatArray, existing: FloatArray, n_wanted: int,
    distance: float, cell_px: int, per_cell: int, width: int, height: int,
) -> BoolArray:  # fmt: skip
    """Which corners (M,) are taken, in order, until there are `n_wanted`.

    `corners` (M, 2) and `existing` features (N, 2): pixels of an image (height, width). A taken
    corner is at least `distance` from all others and from the existing features, and a cell of side
    `cell_px` holds at most `per_cell` of both.
    """
    n_corners, n_existing = len(corners), len(existing)
    columns, rows = -(-width // cell_px), -(-height // cell_px)
    held = np.zeros(rows * columns, dtype=np.int64)
    bins = np.full((int(height // distance) + 1, int(width // distance) + 1), -1)
    taken, after = np.empty((n_existing + n_corners, 2)), np.full(n_existing + n_corners, -1)
    for k in range(n_existing):
        u, v = existing[k]
        taken[k, 0], taken[k, 1] = u, v
        held[_cell_of(u, v, cell_px, rows, columns)] += 1
        _add_to_bin(u, v, distance, bins, k, after)
    chosen = np.zeros(n_corners, dtype=np.bool_)
    n_taken = n_existing
    for k in range(n_corners):
        if n_taken - n_existing >= n_wanted:
            break
        u, v = corners[k]
        cell = _cell_of(u, v, cell_px, rows, columns)
        if held[cell] < per_cell and _is_free(u, v, distance, bins, after, taken):
            chosen[k] = True
            taken[n_taken, 0], taken[n_taken, 1] = u, v
            held[cell] += 1
            _add_to_bin(u, v, distance, bins, n_taken, after)
            n_taken += 1
    return chosen
