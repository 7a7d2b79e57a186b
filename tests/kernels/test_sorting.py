"""Compiled sorting against NumPy."""

import numpy as np
import pytest

from ovmot.kernels.sorting import median, sort_together


@pytest.mark.parametrize("n", [1, 2, 3, 7, 40, 239])
def test_items_go_with_their_keys(n: int) -> None:
    given = np.random.default_rng(n).normal(size=n + 2)
    keys, items = given.copy(), np.arange(n + 2)
    sort_together(keys, items, n)
    np.testing.assert_array_equal(keys, np.append(np.sort(given[:n]), given[n:]))
    np.testing.assert_array_equal(given[items], keys)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 40, 239])
def test_the_median(n: int) -> None:
    values = np.random.default_rng(n).normal(size=n + 2)
    expected = np.median(values[:n])
    assert median(values, n) == pytest.approx(expected, rel=1e-12)
