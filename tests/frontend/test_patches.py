"""Patches: warps that are known are found; what lies off the centre does not drag."""

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.frontend.feature_search import Found, Sought, find_features
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import View, build_pyramid, patch_image
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.runtime import CallingThread
from ovmot.settings import TrackerSettings

SETTINGS = TrackerSettings()


def texture(seed: int) -> FloatArray:
    noise = np.random.default_rng(seed).standard_normal((240, 320))
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(128.0 + 45.0 * soft / soft.std(), np.float64)


def painted(grey: FloatArray) -> Image:
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)


def grid() -> FloatArray:
    u, v = np.meshgrid(np.linspace(60.0, 260.0, 9), np.linspace(50.0, 190.0, 7))
    return np.column_stack([u.ravel(), v.ravel()])


def found(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    n_levels: int = 3,
) -> Found:
    """The points of one image in another one; by their patches alone with no level of flow."""
    store = PatchStore()
    slot = store.add(patch_image(source), points)
    sought = Sought(build_pyramid(source, SETTINGS), points, store, slot)
    camera = Camera.make((320, 240), (300.0, 300.0), (160.0, 120.0))
    view = View(target, build_pyramid(target, SETTINGS), patch_image(target), None, camera)
    return find_features(sought, view, start, n_levels, CallingThread())


@pytest.mark.parametrize(
    "warp", [np.eye(2), np.array([[1.1, 0.05], [-0.04, 0.95]]), np.array([[0.9, -0.1], [0.1, 0.9]])]
)
def test_an_affine_warp_and_a_gain_are_found(warp: FloatArray) -> None:
    """The second image is the first one turned, stretched, shifted and twice as contrasted."""
    grey, points = texture(1), grid()
    middle, shift = np.array([160.0, 120.0]), np.array([1.3, -0.8])
    M = np.column_stack([warp, middle + shift - warp @ middle])
    warped = np.asarray(
        cv2.warpAffine(grey, M, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP),
        np.float64,
    )
    source, target = painted(grey), painted(128.0 + 0.6 * (warped - 128.0) + 12.0)
    truth = (points - middle) @ warp.T + middle + shift
    start = truth + np.random.default_rng(2).uniform(-0.8, 0.8, truth.shape)
    now = found(source, target, points, start)
    assert now.fits.mean() > 0.95
    off = np.linalg.norm(now.uv - truth, axis=1)[now.fits]
    assert np.median(off) < 0.08  # a bilinear sample between pixels is a little soft
    assert np.quantile(off, 0.9) < 0.12
    np.testing.assert_allclose(np.median(now.warp[now.fits], axis=0), warp, atol=0.01)


def test_what_is_not_there_does_not_fit() -> None:
    source, other = painted(texture(1)), painted(texture(5))
    assert found(source, other, grid(), grid(), n_levels=0).fits.mean() < 0.05


def test_the_border_of_a_patch_does_not_drag_its_centre() -> None:
    """From 4 pixels right of each point on, the image moves by 2 pixels; the point does not."""
    still, moving = texture(1), texture(7)
    points = np.array([[100.0, v] for v in np.arange(40.0, 200.0, 12.0)])
    before, after = still.copy(), still.copy()
    before[:, 104:] = moving[:, 104:]
    after[:, 104:] = np.roll(moving, 2, axis=0)[:, 104:]
    now = found(painted(before), painted(after), points, points)
    off = np.linalg.norm(now.uv - points, axis=1)
    assert (~now.fits | (off < 0.6)).mean() > 0.85
    assert np.median(off[now.fits]) < 0.3


def test_slots_are_kept_freed_and_given_again() -> None:
    image, points = patch_image(painted(texture(1))), grid()
    store = PatchStore()
    first = store.add(image, points[:10])
    second = store.add(image, points[10:40])
    assert len(np.intersect1d(first, second)) == 0
    grey = store.patches.grey[second].copy()
    store.keep(second)
    third = store.add(image, points[40:])
    assert len(np.intersect1d(second, third)) == 0
    assert len(np.intersect1d(first, third)) == 10
    np.testing.assert_array_equal(store.patches.grey[second], grey)


def test_a_renewed_patch_is_that_of_a_new_feature() -> None:
    image, other, points = (
        patch_image(painted(texture(1))),
        patch_image(painted(texture(5))),
        grid(),
    )
    renewed, new = PatchStore(), PatchStore()
    slot = renewed.add(image, points)
    renewed.warp[slot] = 2.0 * np.eye(2)
    renewed.renew(other, points, slot)
    anew = new.add(other, points)
    np.testing.assert_array_equal(renewed.patches.grey[slot], new.patches.grey[anew])
    np.testing.assert_array_equal(renewed.warp[slot], np.broadcast_to(np.eye(2), (len(slot), 2, 2)))


def test_the_answer_does_not_depend_on_the_company() -> None:
    source, target = painted(texture(1)), painted(np.roll(texture(1), 1, 1))
    points = grid()
    together = found(source, target, points, points)
    for i in (0, 31, 62):
        alone = found(source, target, points[i : i + 1], points[i : i + 1])
        np.testing.assert_array_equal(alone.uv[0], together.uv[i])


def test_no_patches() -> None:
    nothing = np.empty((0, 2))
    now = found(painted(texture(1)), painted(texture(1)), nothing, nothing)
    assert (now.uv.shape, now.warp.shape, now.fits.shape) == ((0, 2), (0, 2, 2), (0,))
