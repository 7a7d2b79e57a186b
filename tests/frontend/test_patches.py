"""Patches: warps that are known are found; what lies off the centre does not drag."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from ovmot.frontend.patches import align, cut_patches, no_patches, refine_tracked
from ovmot.frontend.preprocessing import smoothed
from ovmot.geometry.arrays import FloatArray, Image


@pytest.fixture(scope="module")
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


def texture(seed: int) -> FloatArray:
    noise = np.random.default_rng(seed).standard_normal((240, 320))
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(128.0 + 45.0 * soft / soft.std(), np.float64)


def painted(grey: FloatArray) -> Image:
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)


def grid() -> FloatArray:
    u, v = np.meshgrid(np.linspace(60.0, 260.0, 9), np.linspace(50.0, 190.0, 7))
    return np.column_stack([u.ravel(), v.ravel()])


@pytest.mark.parametrize(
    "warp", [np.eye(2), np.array([[1.1, 0.05], [-0.04, 0.95]]), np.array([[0.9, -0.1], [0.1, 0.9]])]
)
def test_an_affine_warp_and_a_gain_are_found(warp: FloatArray, workers: ThreadPoolExecutor) -> None:
    """The second image is the first one turned, stretched, shifted and twice as contrasted."""
    grey, points = texture(1), grid()
    middle, shift = np.array([160.0, 120.0]), np.array([1.3, -0.8])
    M = np.column_stack([warp, middle + shift - warp @ middle])
    warped = np.asarray(
        cv2.warpAffine(grey, M, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP),
        np.float64,
    )
    source, target = painted(grey), painted(128.0 + 0.6 * (warped - 128.0) + 12.0)
    patches = cut_patches(smoothed(source), points)
    truth = (points - middle) @ warp.T + middle + shift
    start = truth + np.random.default_rng(2).uniform(-0.8, 0.8, truth.shape)
    uv, found, fits = align(patches, smoothed(target), start, patches.warp, workers)
    assert fits.mean() > 0.95
    off = np.linalg.norm(uv - truth, axis=1)[fits]
    assert np.median(off) < 0.08  # a bilinear sample between pixels is a little soft
    assert np.quantile(off, 0.9) < 0.12
    np.testing.assert_allclose(np.median(found[fits], axis=0), warp, atol=0.01)


def test_what_is_not_there_does_not_fit(workers: ThreadPoolExecutor) -> None:
    points = grid()
    patches = cut_patches(smoothed(painted(texture(1))), points)
    other = smoothed(painted(texture(5)))
    _, _, fits = align(patches, other, points, patches.warp, workers)
    assert fits.mean() < 0.05


def test_the_border_of_a_patch_does_not_drag_its_centre(workers: ThreadPoolExecutor) -> None:
    """From 4 pixels right of each point on, the image moves by 2 pixels; the point does not."""
    still, moving = texture(1), texture(7)
    points = np.array([[100.0, v] for v in np.arange(40.0, 200.0, 12.0)])
    before, after = still.copy(), still.copy()
    before[:, 104:] = moving[:, 104:]
    after[:, 104:] = np.roll(moving, 2, axis=0)[:, 104:]
    patches = cut_patches(smoothed(painted(before)), points)
    uv, _, fits = align(patches, smoothed(painted(after)), points, patches.warp, workers)
    off = np.linalg.norm(uv - points, axis=1)
    assert (~fits | (off < 0.6)).mean() > 0.85
    assert np.median(off[fits]) < 0.3


def test_a_patch_that_fits_no_more_is_taken_anew(workers: ThreadPoolExecutor) -> None:
    points = grid()
    patches = cut_patches(smoothed(painted(texture(1))), points)
    other = smoothed(painted(texture(5)))
    _, _, fits = align(patches, other, points, patches.warp, workers)
    uv, renewed = refine_tracked(patches, other, points, workers)
    assert fits.mean() < 0.05
    np.testing.assert_array_equal(uv[~fits], points[~fits])
    np.testing.assert_array_equal(renewed.grey[~fits], cut_patches(other, points[~fits]).grey)


def test_the_answer_does_not_depend_on_the_company(workers: ThreadPoolExecutor) -> None:
    source, target = smoothed(painted(texture(1))), smoothed(painted(np.roll(texture(1), 1, 1)))
    points = grid()
    patches = cut_patches(source, points)
    together, _, _ = align(patches, target, points, patches.warp, workers)
    for i in (0, 31, 62):
        one = patches.rows(np.array([i]))
        alone, _, _ = align(one, target, points[i : i + 1], one.warp, workers)
        np.testing.assert_array_equal(alone[0], together[i])


def test_no_patches(workers: ThreadPoolExecutor) -> None:
    nothing = no_patches()
    uv, warp, fits = align(
        nothing, smoothed(painted(texture(1))), np.empty((0, 2)), nothing.warp, workers
    )
    assert (uv.shape, warp.shape, fits.shape) == ((0, 2), (0, 2, 2), (0,))
