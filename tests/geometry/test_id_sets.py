"""Sets of ids against NumPy's set functions."""

import numpy as np

from ovmot.geometry.id_sets import contained, positions, union, without


def test_sets_are_those_of_numpy() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        a = np.unique(rng.integers(0, 30, rng.integers(0, 12)))
        ids = rng.permutation(30)[: rng.integers(0, 12)]
        np.testing.assert_array_equal(contained(ids, a), np.isin(ids, a))
        np.testing.assert_array_equal(union(a, ids), np.union1d(a, ids))
        np.testing.assert_array_equal(without(a, ids), np.setdiff1d(a, ids))


def test_positions_in_any_order() -> None:
    rng = np.random.default_rng(1)
    among = rng.permutation(40)[:15]
    ids = rng.integers(0, 40, 30)
    at = positions(ids, among)
    np.testing.assert_array_equal(at >= 0, np.isin(ids, among))
    np.testing.assert_array_equal(among[at[at >= 0]], ids[at >= 0])
    assert positions(ids, among[:0]).tolist() == [-1] * 30
