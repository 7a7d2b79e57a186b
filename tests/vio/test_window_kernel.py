"""The compiled choice of observations against plain NumPy."""

import numpy as np

from ovmot.vio.window_kernel import available_views_compiled, gather_views_compiled

T, F = 6, 40


def test_observations_that_may_be_used() -> None:
    rng = np.random.default_rng(1)
    pixels = rng.normal(size=(T, F, 4))
    pixels[rng.random((T, F)) < 0.3, :2] = np.nan
    pixels[rng.random((T, F)) < 0.3, 2:] = np.nan
    used, dynamic = rng.random((T, F)) < 0.2, rng.random(F) < 0.2
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
