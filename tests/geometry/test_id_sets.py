"""Sets of ids against NumPy's set functions."""

import numpy as np

from ovmot.geometry.id_sets import contained, union, without


def test_sets_are_those_of_numpy() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        a = np.unique(rng.integers(0, 30, rng.integers(0, 12)))
        ids = rng.permutation(30)[: rng.integers(0, 12)]
        np.testing.assert_array_equal(contained(ids, a), np.isin(ids, a))
        np.testing.assert_array_equal(union(a, ids), np.union1d(a, ids))
        np.testing.assert_array_equal(without(a, ids), np.setdiff1d(a, ids))
