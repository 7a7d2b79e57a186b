"""The compiled choice of corners that keep apart."""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part


@part
def is_free(u: float, v: float, taken: FloatArray, row: int, column: int, distance: float) -> bool:
    """Is no taken corner nearer than `distance`? Only the bins around (row, column) can hold one.

    `taken` (rows, columns, 2): the corner of each bin, NaN where none.
    """
    for i in range(max(row - 1, 0), min(row + 2, taken.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, taken.shape[1])):
            if (taken[i, j, 0] - u) ** 2 + (taken[i, j, 1] - v) ** 2 < distance**2:
                return False
    return True


def take_apart(
    points: FloatArray, cell: IntArray, room: IntArray, n_wanted: int, distance: float
) -> BoolArray:
    """Which corners (M,) are taken, in order, `distance` apart, while their cell has room.

    `points` (M, 2), no two in one bin of side `distance`; `cell` (M,): which cell each lies in;
    `room` (C,): how many each may take.
    """
    chosen = np.zeros(len(points), dtype=np.bool_)
    left = room.copy()
    columns = int(points[:, 0].max() // distance) + 1
    rows = int(points[:, 1].max() // distance) + 1
    taken = np.empty((rows, columns, 2))
    taken[:] = np.nan
    n = 0
    for k in range(len(points)):
        if n == n_wanted:
            break
        u, v = points[k]
        row, column = int(v // distance), int(u // distance)
        if left[cell[k]] > 0 and is_free(u, v, taken, row, column, distance):
            chosen[k] = True
            taken[row, column] = points[k]
            left[cell[k]] -= 1
            n += 1
    return chosen


take_apart_compiled = compiled(take_apart, code_folder(Path(__file__)))
