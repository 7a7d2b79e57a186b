import numpy as np
import pytest

from ovmot.evaluation.trajectory import associate_stamps
from ovmot.geometry.arrays import IntArray


def stamps(*values: int) -> IntArray:
    return np.array(values, dtype=np.int64)


@pytest.mark.parametrize(
    ("reference", "estimate", "pairs"),
    [
        ((0, 10, 20), (0, 10, 20), [(0, 0), (1, 1), (2, 2)]),
        ((0, 10, 20), (12, 18), [(1, 0), (2, 1)]),
        ((0, 10, 20), (-3, 23, 24), [(0, 0), (2, 1)]),  # 24 comes second
        ((0, 10, 20), (8, 9, 12), [(1, 1)]),  # one each: the nearest has it
        ((0, 10), (5,), [(1, 0)]),  # as near to both: the later
        ((0, 10), (-4,), []),  # 4 apart
        ((), (1,), []),
        ((1,), (), []),
    ],
)
def test_pairs(
    reference: tuple[int, ...], estimate: tuple[int, ...], pairs: list[tuple[int, int]]
) -> None:
    limit = 5 if 5 in estimate else 3
    a, b = associate_stamps(stamps(*reference), stamps(*estimate), limit)
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == pairs


def test_nanoseconds_of_today_stay_exact() -> None:
    start = 1_700_000_000_000_000_000
    a, b = associate_stamps(stamps(start, start + 3), stamps(start + 1, start + 2), 1)
    assert (a.tolist(), b.tolist()) == ([0, 1], [0, 1])
