"""Compiled sorting of a few values, in place: NumPy's own sorting compiles for seconds.

Called by kernels only. `tests/kernels/test_sorting.py` compares with NumPy.
"""

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import part


@part
def sort_together(keys: FloatArray, items: IntArray, n: int) -> None:
    """Sort the first n keys, and the items with them (Shell sort; D. Knuth, TAOCP vol. 3)."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            key, item, k = keys[i], items[i], i
            while k >= gap and keys[k - gap] > key:
                keys[k], items[k] = keys[k - gap], items[k - gap]
                k -= gap
            keys[k], items[k] = key, item
        gap //= 3


@part
def median(values: FloatArray, n: int) -> float:
    """The median of the first n values, n > 0; they are sorted then."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            value, k = values[i], i
            while k >= gap and values[k - gap] > value:
                values[k] = values[k - gap]
                k -= gap
            values[k] = value
        gap //= 3
    return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))
