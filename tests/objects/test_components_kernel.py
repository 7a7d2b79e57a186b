"""Components equal those of scipy's graph search."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ovmot.geometry.arrays import IntArray
from ovmot.objects.components_kernel import components, components_compiled


@pytest.mark.parametrize("search", [components, components_compiled])
@pytest.mark.parametrize("n_pairs", [0, 15, 40])
def test_components_are_those_of_the_graph(
    search: Callable[[IntArray, int], IntArray], n_pairs: int
) -> None:
    for seed in range(10):
        pairs = np.random.default_rng(seed).integers(0, 40, (n_pairs, 2))
        graph = coo_array((np.ones(n_pairs), (pairs[:, 0], pairs[:, 1])), shape=(40, 40))
        _, expected = connected_components(graph, directed=False)
        np.testing.assert_array_equal(search(pairs, 40), expected)
