"""The choice of corners, compiled and as plain Python, against a search through all pairs."""

import numpy as np
import pytest

from ovmot.frontend.spread_kernel import take_apart, take_apart_compiled
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray


def by_all_pairs(
    points: FloatArray, cell: IntArray, room: IntArray, n_wanted: int, distance: float
) -> BoolArray:
    chosen = np.zeros(len(points), dtype=bool)
    for k, point in enumerate(points):
        if chosen.sum() == n_wanted:
            break
        apart = np.linalg.norm(points[chosen] - point, axis=1)
        has_room = np.sum(cell[chosen] == cell[k]) < room[cell[k]]
        chosen[k] = has_room and not np.any(apart < distance)
    return chosen


@pytest.mark.parametrize("n_wanted", [5, 400])
@pytest.mark.parametrize("distance", [2.0, 5.0, 12.5])
def test_the_first_with_room_around_them_are_taken(n_wanted: int, distance: float) -> None:
    rng = np.random.default_rng(3)
    points = np.round(rng.uniform(8.0, 200.0, (600, 2)))
    _, first = np.unique(points // distance, axis=0, return_index=True)
    points = points[np.sort(first)]
    cell = (points[:, 1] // 64 * 4 + points[:, 0] // 64).astype(np.int64)
    room = rng.integers(-2, 30, 16)
    expected = by_all_pairs(points, cell, room, n_wanted, distance)
    assert 0 < expected.sum() <= n_wanted
    for function in (take_apart_compiled, take_apart):
        chosen = function(points, cell, room, n_wanted, distance)
        np.testing.assert_array_equal(chosen, expected)
