"""The compiled search for connected components."""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import IntArray
from ovmot.kernels.cache import code_folder, compiled


def components(pairs: IntArray, n: int) -> IntArray:
    """Component (n,) of each node by links (P, 2), numbered in the order of their first nodes.

    Each node points to one with no greater index of its own component; roots are joined in turn.
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


components_compiled = compiled(components, code_folder(Path(__file__)))
