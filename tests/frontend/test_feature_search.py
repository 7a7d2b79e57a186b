"""The search for features on images whose motion is known."""

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.frontend.feature_search import (
    Found,
    Sought,
    find_features,
    match_templates,
    near_levels,
    recover_lost,
)
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import View, build_pyramid, patch_image
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, Image
from ovmot.runtime import CallingThread
from ovmot.settings import TrackerSettings

SETTINGS = TrackerSettings(klt_window_px=15, klt_levels=5)


@pytest.fixture(scope="module")
def texture() -> AnyArray:
    """Blobs about two pixels wide, drawn eight times as fine as a pixel."""
    noise = np.random.default_rng(3).standard_normal((2400, 3200)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 8 * 1.8)
    return np.asarray(128.0 + 50.0 * smooth / smooth.std())


def painted(texture: AnyArray, shift: tuple[float, float]) -> Image:
    """200x300 pixels of the texture, moved right and down by whole eighths of a pixel, exactly."""
    u, v = 400 - round(8 * shift[0]), 400 - round(8 * shift[1])
    cut = texture[v : v + 1600 : 8, u : u + 2400 : 8]
    return np.asarray(np.clip(np.round(cut), 0, 255), dtype=np.uint8)


@pytest.fixture(scope="module")
def points() -> FloatArray:
    u, v = np.meshgrid(np.linspace(60.0, 240.0, 12), np.linspace(50.0, 150.0, 7))
    return np.column_stack([u.ravel(), v.ravel()])


def view_of(image: Image, settings: TrackerSettings) -> View:
    camera = Camera.make(image.shape[::-1], (300.0, 300.0), (150.0, 100.0))
    return View(image, build_pyramid(image, settings), patch_image(image), None, camera)


def sought_in(image: Image, points: FloatArray, settings: TrackerSettings) -> Sought:
    store = PatchStore()
    slot = store.add(patch_image(image), points)
    return Sought(build_pyramid(image, settings), points, store, slot)


def found(
    source: Image, target: Image, points: FloatArray, start: FloatArray,
    settings: TrackerSettings,
) -> Found:  # fmt: skip
    view = view_of(target, settings)
    n_levels = near_levels(settings)
    return find_features(
        sought_in(source, points, settings), view, start, n_levels, CallingThread()
    )


def look(
    source: Image, target: Image, points: FloatArray, start: FloatArray,
    settings: TrackerSettings,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Positions, and which were found."""
    search = found(source, target, points, start, settings)
    return search.uv, search.found


def unknown(points: FloatArray) -> FloatArray:
    return np.full_like(points, np.nan)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.375, -2.625), (-7.75, 5.125)])
def test_a_shift_is_found_below_a_tenth_of_a_pixel(
    texture: AnyArray, points: FloatArray, shift: tuple[float, float]
) -> None:
    source, target = painted(texture, (0.0, 0.0)), painted(texture, shift)
    found, ok = look(source, target, points, unknown(points), SETTINGS)
    assert ok.mean() > 0.95
    error = found[ok] - points[ok] - shift
    assert np.abs(error).max() < 0.1
    assert np.abs(error.mean(0)).max() < 0.005


def test_a_large_shift_needs_its_predicted_start(texture: AnyArray, points: FloatArray) -> None:
    shift = (48.0, -31.0)
    source, target = painted(texture, (0.0, 0.0)), painted(texture, shift)
    flat = SETTINGS.model_copy(update={"klt_levels": 3})
    blind, ok_blind = look(source, target, points, unknown(points), flat)
    right = np.linalg.norm(blind - points - shift, axis=1) < 0.5
    assert (ok_blind & right).mean() < 0.05
    start = points + shift + np.random.default_rng(0).uniform(-1.5, 1.5, points.shape)
    found, ok = look(source, target, points, start, flat)
    right = np.linalg.norm(found - points - shift, axis=1) < 0.1
    assert (ok & right).mean() > 0.9


def test_points_are_found_from_their_own_starts(texture: AnyArray, points: FloatArray) -> None:
    """A NaN start means the old position, for that point alone."""
    source, target = painted(texture, (0.0, 0.0)), painted(texture, (2.0, 1.0))
    start = unknown(points)
    start[::2] = points[::2] + np.array([2.0, 1.0])
    found, ok = look(source, target, points, start, SETTINGS)
    assert ok.mean() > 0.95
    np.testing.assert_allclose(found[ok] - points[ok], [[2.0, 1.0]] * ok.sum(), atol=0.1)


def test_what_is_gone_is_flagged(texture: AnyArray, points: FloatArray) -> None:
    source, target = painted(texture, (0.0, 0.0)), painted(texture, (1.0, 0.0))
    other = np.random.default_rng(9).integers(0, 255, target.shape).astype(np.uint8)
    gone = target.copy()
    gone[:, 150:] = cv2.GaussianBlur(other, (0, 0), 1.5)[:, 150:]
    _, ok = look(source, gone, points, unknown(points), SETTINGS)
    assert ok[points[:, 0] < 130].mean() > 0.9
    assert ok[points[:, 0] > 170].mean() < 0.2
    flat = np.full_like(target, 128)
    assert not look(source, flat, points, unknown(points), SETTINGS)[1].any()


def test_no_points() -> None:
    image = np.zeros((50, 50), dtype=np.uint8)
    nothing = np.empty((0, 2))
    found, ok = look(image, image, nothing, nothing, SETTINGS)
    assert (found.shape, ok.shape) == ((0, 2), (0,))


def test_one_point_alone_gives_the_same_as_among_others(
    texture: AnyArray, points: FloatArray
) -> None:
    source, target = painted(texture, (0.0, 0.0)), painted(texture, (2.25, 1.125))
    together, _ = look(source, target, points, unknown(points), SETTINGS)
    for i in (0, 41, 83):
        one = points[i : i + 1]
        alone, _ = look(source, target, one, unknown(one), SETTINGS)
        np.testing.assert_array_equal(alone[0], together[i])


def test_what_one_look_lost_is_found_by_another_where_it_is_like(
    texture: AnyArray, points: FloatArray
) -> None:
    """Half of the image moves far; its points are lost near their old places."""
    shift = np.array([44.0, 3.0])
    source, target = painted(texture, (0.0, 0.0)), painted(texture, (0.0, 0.0))
    target = np.hstack([target[:, :150], painted(texture, (44.0, 3.0))[:, 150:]])
    moved = points[:, 0] > 150
    near = SETTINGS.model_copy(update={"klt_levels": 3})
    sought, view = sought_in(source, points, near), view_of(target, near)
    first = find_features(sought, view, unknown(points), near_levels(near), CallingThread())
    lost = moved & ~first.found & (points[:, 0] < 240)
    assert lost.sum() > 10
    places = np.stack([points + shift, points])
    again = recover_lost(sought, view, first, places, near, CallingThread())
    np.testing.assert_array_equal(again.uv[first.found], first.uv[first.found])
    off = np.linalg.norm(again.uv - points - shift, axis=1)
    assert (again.found & (off < 0.2))[lost].mean() > 0.8
    flat = np.full_like(target, 128)
    flat[:, :150] = target[:, :150]
    view = view_of(flat, near)
    nowhere = find_features(sought, view, unknown(points), near_levels(near), CallingThread())
    again = recover_lost(sought, view, nowhere, places, near, CallingThread())
    assert not again.found[points[:, 0] > 170].any()


def test_patches_are_found_farther_than_flow_reaches(texture: AnyArray) -> None:
    before, after = (build_pyramid(painted(texture, s), SETTINGS) for s in ((0, 0), (36, 4)))
    points = np.array([[120.0, 90.0], [180.0, 110.0], [1.0, 1.0]])
    found = match_templates(before, after, points, points, np.full(3, 60.0))
    np.testing.assert_allclose(found[:2] - points[:2], [[36.0, 4.0]] * 2, atol=1.01)
    assert np.isnan(found[2]).all()  # its patch is not all in the image
    assert np.isnan(match_templates(before, after, points, points, np.full(3, 20.0))).all()


def test_a_patch_that_is_found_twice_is_found_nowhere(texture: AnyArray) -> None:
    """A row of equal windows: the third is within reach of a shift of one and of two."""
    once = painted(texture, (0.0, 0.0))
    rows = np.tile(once[:, :40], (1, 8))
    before, after = build_pyramid(rows, SETTINGS), build_pyramid(np.roll(rows, 12, 1), SETTINGS)
    points = np.array([[140.0, 90.0]])
    unique = match_templates(before, after, points, points, np.array([24.0]))
    np.testing.assert_allclose(unique - points, [[12.0, 0.0]], atol=1.01)
    assert np.isnan(match_templates(before, after, points, points, np.array([60.0]))).all()
