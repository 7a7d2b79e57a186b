"""Medians over neighbours, compiled and plain, against a k-d tree."""

import inspect

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ovmot.frontend.neighbour_kernel import NEAREST, nearest_medians


@pytest.mark.parametrize("n_features", [NEAREST, 80])
@pytest.mark.parametrize("n_values", [1, 2])
def test_medians_are_those_of_the_nearest(n_features: int, n_values: int) -> None:
    rng = np.random.default_rng(n_features)
    uv, where = rng.uniform(0.0, 300.0, (n_features, 2)), rng.uniform(0.0, 300.0, (30, 2))
    values = rng.standard_normal((n_features, n_values))
    _, nearest = cKDTree(uv).query(where, k=NEAREST)
    expected = np.median(values[nearest], axis=1)
    for function in (nearest_medians, inspect.unwrap(nearest_medians)):
        np.testing.assert_array_equal(function(uv, values, where), expected)
