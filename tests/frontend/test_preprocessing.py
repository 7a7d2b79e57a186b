"""Images made ready: contrast corrections of a dark, flat image, pyramids, masks."""

import numpy as np
import pytest

from ovmot.frontend.klt_kernel import margin_of
from ovmot.frontend.preprocessing import EQUALIZERS, build_pyramid, inside_mask
from ovmot.geometry.arrays import Image
from ovmot.settings import TrackerSettings


@pytest.fixture
def dark() -> Image:
    """Grey 40 to 60, darker to the left."""
    noise = np.random.default_rng(0).integers(0, 12, (120, 160))
    return np.asarray(40 + noise + np.arange(160) // 20, dtype=np.uint8)


def test_the_histogram_is_spread_over_all_greys(dark: Image) -> None:
    out = EQUALIZERS["histogram"](dark)
    assert out.dtype == np.uint8
    assert (int(out.min()), int(out.max())) == (0, 255)
    order = np.argsort(dark.ravel(), kind="stable")
    assert np.all(np.diff(out.ravel()[order].astype(int)) >= 0)  # no grey overtakes another
    # brightness and gain of the camera do not matter
    brighter = np.asarray(2 * dark.astype(int) + 20, dtype=np.uint8)
    np.testing.assert_array_equal(EQUALIZERS["histogram"](brighter), out)


def test_clahe_corrects_each_place_for_itself(dark: Image) -> None:
    out = EQUALIZERS["clahe"](dark).astype(float)
    assert out.std() > 2.0 * dark.std()
    slope_before = float(dark[:, 80:].mean()) - float(dark[:, :80].mean())
    slope_after = out[:, 80:].mean() - out[:, :80].mean()
    assert slope_after / out.std() < slope_before / dark.std()


def test_none_leaves_the_image_as_it_is(dark: Image) -> None:
    assert EQUALIZERS["none"](dark) is dark


def test_the_linear_stretch_has_one_gain_for_all_greys(dark: Image) -> None:
    low = float(np.percentile(dark[::4, ::4], 2.0))
    out = EQUALIZERS["linear"](dark).astype(float)
    expected = np.clip(4.0 * (dark.astype(float) - low), 0.0, 255.0)  # night stays night
    assert np.abs(out - expected).max() <= 4.0
    ramp = np.tile(np.linspace(60.0, 180.0, 160), (120, 1)).astype(np.uint8)
    stretched = EQUALIZERS["linear"](ramp).astype(float)
    assert stretched.min() == 0.0
    assert stretched.max() == 255.0
    inner = (stretched > 5.0) & (stretched < 250.0)
    slope = np.polyfit(ramp[inner], stretched[inner], 1)[0]
    assert slope == pytest.approx(255.0 / (0.96 * 120.0), rel=0.03)


@pytest.mark.parametrize("name", EQUALIZERS)
def test_a_blank_image_is_no_trouble(name: str) -> None:
    out = EQUALIZERS[name](np.full((120, 160), 77, dtype=np.uint8))
    assert out.dtype == np.uint8
    assert np.ptp(out) == 0


def test_a_pyramid_stops_at_the_size_of_its_window() -> None:
    """Levels are halves of each other, padded alike, and an image of any size has one at least."""
    settings = TrackerSettings(klt_window_px=11, klt_levels=5)
    pyramid = build_pyramid(np.zeros((50, 80), dtype=np.uint8), settings)
    margin = margin_of(11)
    sides = [tuple(side - 2 * margin for side in level.shape) for level in pyramid.levels]
    assert sides == [(50, 80), (25, 40), (13, 20)]
    assert len(build_pyramid(np.zeros((9, 9), dtype=np.uint8), settings).levels) == 1


def test_a_pixel_is_masked_where_the_mask_is_not_zero() -> None:
    mask = np.zeros((4, 6), dtype=np.uint8)
    mask[1, 2] = 7
    uv = np.array([[2.4, 0.6], [2.6, 1.0], [-1.0, 1.0], [6.0, 3.0], [np.nan, 1.0]])
    assert inside_mask(uv, mask).tolist() == [True, False, False, False, False]
    assert not inside_mask(uv, None).any()
