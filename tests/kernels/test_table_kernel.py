"""The compiled work on the feature table's arrays against plain NumPy."""

import numpy as np
import pytest

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.table_kernel import (
    available_views_compiled,
    columns_of_compiled,
    count_still_compiled,
    gather_views_compiled,
    live_columns_compiled,
)
from ovmot.types import tracked_pixels

T, F = 6, 40


def arrays(rng: np.random.Generator) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Pixels (T, F, 4), some of them unseen, used (T, F) and dynamic (F,)."""
    pixels = rng.normal(size=(T, F, 4))
    pixels[rng.random((T, F)) < 0.3, :2] = np.nan
    pixels[rng.random((T, F)) < 0.3, 2:] = np.nan
    pixels[1:, ::2] = np.nan
    return pixels, rng.random((T, F)) < 0.2, rng.random(F) < 0.2


@pytest.mark.parametrize("n", [0, 1, 2, 300])
def test_columns_of_features(n: int) -> None:
    rng = np.random.default_rng(5)
    among = rng.permutation(np.r_[-5, rng.choice(10**12, n), 10**12 + 1024 * np.arange(n)])
    ids = rng.permutation(np.r_[among[::2], 10**12 + 7, -6])
    expected = [among.tolist().index(k) if k in among else -1 for k in ids]
    assert columns_of_compiled(ids, among).tolist() == expected
    assert columns_of_compiled(ids, among[:0]).tolist() == [-1] * len(ids)


def test_observations_that_may_be_used() -> None:
    pixels, used, dynamic = arrays(np.random.default_rng(1))
    rows = np.array([True, True, False, True, True, False])
    seen = np.isfinite(pixels[..., ::2]).any(axis=-1)
    expected = seen & ~used & ~dynamic & rows[:, None]
    np.testing.assert_array_equal(available_views_compiled(pixels, used, dynamic, rows), expected)
    assert 0.1 < expected.mean() < 0.9


def test_views_are_gathered_clone_by_clone() -> None:
    rng = np.random.default_rng(2)
    pixels, normalized = rng.normal(size=(2, T, F, 4))
    available, column, row = rng.random((T, F)) < 0.5, np.array([3, 17, 39]), np.array([0, -1, 4])
    found = gather_views_compiled(pixels, normalized, available, column, row)
    for values, given in zip(found, (pixels, normalized), strict=True):
        expected = np.full((3, 3, 4), np.nan)
        for k in (0, 2):
            kept = available[row[k], column]
            expected[kept, k] = given[row[k], column[kept]]
        np.testing.assert_array_equal(values, expected)
        assert np.isfinite(values).any()


def test_columns_live_while_they_are_seen_or_fresh() -> None:
    pixels, used, dynamic = arrays(np.random.default_rng(4))
    row = np.array([0, 2, 5])
    seen = np.isfinite(pixels[row][..., ::2]).any(axis=-1)
    expected = seen[-1] | (seen & ~used[row] & ~dynamic).any(axis=0)
    np.testing.assert_array_equal(live_columns_compiled(pixels, used, dynamic, row), expected)
    assert 0.2 < expected.mean() < 0.95


def test_features_that_keep_their_place_are_counted() -> None:
    pixels, _, _ = arrays(np.random.default_rng(6))
    earlier, now = pixels[0], pixels[0] + np.random.default_rng(7).normal(0.0, 0.5, (F, 4))
    now[::5] = np.nan
    column = np.arange(3, F)
    way = np.linalg.norm(tracked_pixels(now) - tracked_pixels(earlier), axis=1)[column]
    n_both, n_still = count_still_compiled(earlier, now, column, 0.6)
    assert (n_both, n_still) == (np.isfinite(way).sum(), (way < 0.6).sum())
    assert 5 < n_still < n_both < len(column)
