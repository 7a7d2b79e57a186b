"""Compiled loops over groups of points: connected components, and how well a group's velocity is
known.

tests/objects/test_clustering_kernel.py holds the plain twins.
"""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled


def components(pairs: IntArray, n: int) -> IntArray:
    """Component (n,) of each node by links (P, 2), numbered in the order of their first nodes.

    Union-find: each node points to one with no greater index of its own component; roots are joined
    in turn.
    """
    root = np.arange(n)
    for a, b in pairs:
        while root[a] != a:
            a = root[a]  # noqa: PLW2901
        while root[b] != b:
            b = root[b]  # noqa: PLW2901
        root[max(a, b)] = min(a, b)
    number, count = np.empty(n, dtype=np.int64), 0
    for k in range(n):
        if root[k] == k:
            number[k] = count
            count += 1
        else:
            number[k] = number[root[k]]
    return number


def displacement_errors(
    information: FloatArray, weight: FloatArray, index: IntArray
) -> tuple[FloatArray, IntArray]:
    """Error of the common displacement of points (n,) since each of L rows, and their number there.

    Traces (L,) of the inverse of summed `information` (L, M, 3, 3), m²; a point is seen in a row
    where its `weight` (L, M, 4, 4) is not zero.
    """
    trace, count = np.empty(len(information)), np.zeros(len(information), dtype=np.int64)
    total = np.empty((3, 3))
    for row in range(len(information)):
        for a in range(3):
            for b in range(3):
                total[a, b] = 1e-6 if a == b else 0.0
        for n in index:
            count[row] += weight[row, n, 0, 0] > 0.0
            for a in range(3):
                for b in range(3):
                    total[a, b] += information[row, n, a, b]
        A = total[1, 1] * total[2, 2] - total[1, 2] * total[2, 1]
        B = total[1, 2] * total[2, 0] - total[1, 0] * total[2, 2]
        C = total[1, 0] * total[2, 1] - total[1, 1] * total[2, 0]
        minors = A + total[0, 0] * total[2, 2] - total[0, 2] * total[2, 0]
        minors += total[0, 0] * total[1, 1] - total[0, 1] * total[1, 0]
        trace[row] = minors / (total[0, 0] * A + total[0, 1] * B + total[0, 2] * C)
    return trace, count


_FOLDER = code_folder(Path(__file__))
components_compiled = compiled(components, _FOLDER)
displacement_errors_compiled = compiled(displacement_errors, _FOLDER)
