"""The choice of corners, compiled and as plain Python, against a search through all pairs."""

import inspect

import numpy as np
import pytest

from ovmot.frontend.spread_kernel import spread_corners
from ovmot.geometry.arrays import BoolArray, FloatArray

CELL, PER_CELL, SIZE = 64, 12, (210, 205)


def by_all_pairs(
    corners: FloatArray, existing: FloatArray, n_wanted: int, distance: float
) -> BoolArray:
    chosen = np.zeros(len(corners), dtype=bool)
    for k, corner in enumerate(corners):
        if chosen.sum() == n_wanted:
            break
        taken = np.concatenate([existing, corners[chosen]])
        apart = np.linalg.norm(taken - corner, axis=1)
        in_cell = (taken // CELL == corner // CELL).all(axis=1)
        chosen[k] = in_cell.sum() < PER_CELL and not np.any(apart < distance)
    return chosen


@pytest.mark.parametrize("n_wanted", [5, 400])
@pytest.mark.parametrize("n_existing", [0, 60])
@pytest.mark.parametrize("distance", [2.0, 5.0, 12.5])
def test_the_first_with_room_around_them_are_taken(
    n_wanted: int, n_existing: int, distance: float
) -> None:
    rng = np.random.default_rng(3)
    corners = np.round(rng.uniform(8.0, 200.0, (600, 2)))
    existing = rng.uniform(5.0, 203.0, (n_existing, 2))
    expected = by_all_pairs(corners, existing, n_wanted, distance)
    assert 0 < expected.sum() <= n_wanted
    for function in (spread_corners, inspect.unwrap(spread_corners)):
        chosen = function(corners, existing, n_wanted, distance, CELL, PER_CELL, *SIZE)
        np.testing.assert_array_equal(chosen, expected)
