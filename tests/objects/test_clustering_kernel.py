"""Components equal those of SciPy's graph search, errors those of NumPy's inverse."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.clustering_kernel import (
    components,
    components_compiled,
    displacement_errors,
    displacement_errors_compiled,
)


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


@pytest.mark.parametrize("errors", [displacement_errors, displacement_errors_compiled])
def test_errors_are_traces_of_the_inverse(
    errors: Callable[..., tuple[FloatArray, IntArray]],
) -> None:
    rng = np.random.default_rng(5)
    L = rng.normal(0.0, 3.0, (4, 9, 3, 3))
    information = L @ np.swapaxes(L, -1, -2)
    weight = np.tile(np.eye(4), (4, 9, 1, 1))
    weight[2, [1, 5]] = 0.0
    index = np.array([1, 4, 5])
    trace, count = errors(information, weight, index)
    inverse = np.linalg.inv(information[:, index].sum(1) + 1e-6 * np.eye(3))
    np.testing.assert_allclose(trace, np.trace(inverse, axis1=1, axis2=2), rtol=1e-8)
    np.testing.assert_array_equal(count, [3, 3, 1, 3])
