"""Passes over whole images: each kernel against its plain twin, and OpenCV's smoothing."""

import cv2
import numpy as np
import pytest

from ovmot.frontend.image_kernel import (
    grey_range_compiled,
    scale_levels_compiled,
    thin_out_compiled,
)
from ovmot.frontend.patch_kernel import MARGIN
from ovmot.frontend.preprocessing import patch_image, stretch_linearly
from ovmot.geometry.arrays import Image

SHAPES = [(3, 3), (7, 50), (61, 33), (120, 160)]


def noise(shape: tuple[int, int]) -> Image:
    """An image of uniform noise."""
    return np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("shape", SHAPES)
def test_words_hold_the_smoothed_image_and_its_neighbours(shape: tuple[int, int]) -> None:
    image = noise(shape)
    smooth = cv2.GaussianBlur(image, (5, 5), 0.8, borderType=cv2.BORDER_REFLECT_101)
    padded = np.pad(smooth, ((MARGIN, MARGIN + 1), (MARGIN, MARGIN + 1)), mode="edge")
    expected = np.stack(
        [padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]], axis=-1
    )
    words = patch_image(image)
    found = np.stack([(words >> shift) & 255 for shift in (0, 8, 16, 24)], axis=-1)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize("percent", [(0.0, 100.0), (2.0, 98.0), (37.3, 50.0)])
def test_percentiles_of_greys_are_those_of_numpy(
    shape: tuple[int, int], step: int, percent: tuple[float, float]
) -> None:
    for image in (noise(shape), noise(shape) // 100 * 50):  # all levels, and three
        expected = np.percentile(image[::step, ::step], percent)
        np.testing.assert_allclose(grey_range_compiled(image, step, *percent), expected, rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step", [1, 8])
def test_a_thinned_image_and_its_equal_rows(shape: tuple[int, int], step: int) -> None:
    image = noise(shape)
    expected = image[:, ::step]
    last = expected.copy()
    last[::3, -1] += 1
    nothing = np.empty((0, 0), dtype=np.uint8)
    for before, same in ((last, (last == expected).all(axis=1)), (nothing, [False] * shape[0])):
        thin, equal, low, high = thin_out_compiled(image, step, before, 1.0, 99.0)
        np.testing.assert_array_equal(thin, expected)
        np.testing.assert_array_equal(equal, same)
        assert (low, high) == grey_range_compiled(image, step, 1.0, 99.0)


@pytest.mark.parametrize(("low", "gain"), [(0.0, 1.0), (37.5, 1.7), (80.0, 4.0)])
def test_scaled_levels_are_those_of_the_formula(low: float, gain: float) -> None:
    image = noise((120, 160))
    expected = np.clip((image.astype(float) - low) * gain, 0.0, 255.0).astype(np.uint8)
    found = scale_levels_compiled(image, low, gain)
    # single precision may fall on the other side of a whole number
    assert np.abs(found.astype(int) - expected).max() <= 1
    assert (found != expected).mean() < 0.01


def test_an_image_that_may_not_be_written_is_as_good() -> None:
    image = noise((40, 60))
    kept = image.copy()
    kept.flags.writeable = False
    np.testing.assert_array_equal(stretch_linearly(kept), stretch_linearly(image))
    np.testing.assert_array_equal(patch_image(kept[:, 5:50]), patch_image(image[:, 5:50].copy()))
