"""The compiled work on patches equals its plain NumPy twins."""

import cv2
import numpy as np

from ovmot.frontend.feature_kernel import ALIGNED, find_features_compiled
from ovmot.frontend.feature_search import MIN_CORRELATION
from ovmot.frontend.patch_kernel import Patch
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import build_pyramid, patch_image
from ovmot.geometry.arrays import AnyArray, FloatArray, Image, IntArray
from ovmot.settings import TrackerSettings

SETTINGS = TrackerSettings()
STEPS, SMALL, FAR = 8, 0.02, 3.0
RADIUS, PIXELS = 6, 169
OFFSETS = np.indices((13, 13), dtype=np.float32)[::-1].reshape(2, -1) - RADIUS
ROOT_WEIGHT = np.exp(
    -0.25 * np.add.outer(np.arange(-6.0, 7.0) ** 2, np.arange(-6.0, 7.0) ** 2).ravel() / 9.0
).astype(np.float32)


def painted(seed: int) -> Image:
    noise = np.random.default_rng(seed).standard_normal((120, 160))
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(np.clip(128.0 + 45.0 * soft / soft.std(), 0, 255), dtype=np.uint8)


def smooth(image: Image) -> AnyArray:
    return np.asarray(cv2.GaussianBlur(image, (5, 5), 0.8))


def steepest_of(patches: Patch) -> AnyArray:
    """Derivatives (S, 6, PIXELS) by a shift and by the warp, as they follow from what is kept."""
    by_u, by_v = patches.slope[:, 0, :PIXELS], patches.slope[:, 1, :PIXELS]
    x, y = OFFSETS / RADIUS
    rows = np.stack([by_u, by_v, by_u * x, by_u * y, by_v * x, by_v * y], axis=1)
    root = ROOT_WEIGHT / np.linalg.norm(ROOT_WEIGHT)
    offset, gain = patches.gain[:, :, :1], patches.gain[:, :, 1:]
    return np.asarray(rows - offset * root - gain * patches.grey[:, None, :PIXELS])


def twin(
    image: AnyArray, store: PatchStore, slot: IntArray, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All points at once, in NumPy."""
    axis = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
    offsets = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    uv, warp = start.copy(), store.warp[slot]
    all_grey, all_steepest = store.patches.grey[slot, :PIXELS], steepest_of(store.patches)[slot]
    correlation, going, before = np.zeros(len(uv)), np.arange(len(uv)), np.zeros(len(uv))
    weight = (ROOT_WEIGHT.astype(np.float64) ** 2) / (ROOT_WEIGHT.astype(np.float64) ** 2).sum()
    for _ in range(STEPS):
        seen = sampled(image, uv[going, None] + offsets @ np.swapaxes(warp[going], 1, 2))
        seen = (seen - (seen * weight).sum(1, keepdims=True)) * ROOT_WEIGHT
        seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-3)
        error = seen - all_grey[going]
        correlation[going] = 1.0 - 0.5 * (error**2).sum(1)
        step = np.einsum(
            "nij,njm,nm->ni", store.patches.inverse[slot[going]], all_steepest[going], error
        )
        change = np.eye(2) + step[:, 2:].reshape(-1, 2, 2) / RADIUS
        warp[going] = warp[going] @ np.linalg.inv(change)
        uv[going] -= (warp[going] @ step[:, :2, None])[..., 0]
        near = np.linalg.norm(uv[going] - start[going], axis=1) < FAR
        correlation[going[~near]] = 0.0
        size, last = np.abs(step[:, :2]).max(axis=1), before[going]
        before[going] = size
        going = going[near & (size > SMALL) & (size**2 > SMALL * (last - size))]
    return uv, warp, correlation


def test_the_compiled_alignment_agrees_with_the_twin() -> None:
    source = patch_image(painted(1))
    target_image = np.roll(painted(1), (1, 2), axis=(0, 1))
    target = patch_image(target_image)
    points = np.random.default_rng(3).uniform(
        [2.0, 2.0], [157.0, 117.0], (40, 2)
    )  # some at the border
    start = points + np.array([1.4, 0.7])
    store = PatchStore()
    slot = store.add(source, points)
    expected = twin(smooth(target_image), store, slot, start)
    levels, no_flow = build_pyramid(target_image, SETTINGS).levels, 0
    n = len(points)
    uv, warp, state = start.copy(), store.warp[slot], np.zeros(n, dtype=np.uint8)
    find_features_compiled(
        levels, levels, target, SETTINGS.klt_window_px, store.patches,
        slot, store.warp, points, np.arange(n), start[None], np.full((1, n), no_flow), False,
        MIN_CORRELATION, MIN_CORRELATION, STEPS, SMALL, uv, warp, state,
    )  # fmt: skip
    fits = state == ALIGNED
    clear = np.abs(expected[2] - MIN_CORRELATION) > 1e-3
    np.testing.assert_array_equal(fits[clear], expected[2][clear] > MIN_CORRELATION)
    np.testing.assert_allclose(uv[fits], expected[0][fits], atol=1e-4)
    np.testing.assert_allclose(warp[fits], expected[1][fits], atol=1e-4)
    assert fits.mean() > 0.5


def sampled(image: AnyArray, uv: FloatArray) -> FloatArray:
    """Bilinear grey levels at pixels (..., 2), the image continued by its border."""
    where = np.clip(uv, 0.0, np.array(image.shape[::-1]) - 1.0)
    corner = np.minimum(where.astype(int), np.array(image.shape[::-1]) - 2)
    a, b = np.moveaxis(where - corner, -1, 0)
    u, v = np.moveaxis(corner, -1, 0)
    grey = image.astype(np.float64)
    above = (1 - a) * grey[v, u] + a * grey[v, u + 1]
    below = (1 - a) * grey[v + 1, u] + a * grey[v + 1, u + 1]
    return np.asarray((1 - b) * above + b * below)


def test_a_cut_patch_is_that_of_the_twin() -> None:
    image = smooth(painted(1))
    points = np.random.default_rng(5).uniform([1.0, 1.0], [158.0, 118.0], (25, 2))
    store = PatchStore()
    slot = store.add(patch_image(painted(1)), points)
    weight = ROOT_WEIGHT.astype(np.float64) ** 2
    weight /= weight.sum()
    offset = OFFSETS.T.astype(np.float64)
    for n, uv in enumerate(points):
        grey = sampled(image, uv + offset)
        by_u = 0.5 * (sampled(image, uv + offset + [1, 0]) - sampled(image, uv + offset - [1, 0]))
        by_v = 0.5 * (sampled(image, uv + offset + [0, 1]) - sampled(image, uv + offset - [0, 1]))
        x, y = offset.T / RADIUS
        steepest = np.stack([by_u, by_v, by_u * x, by_u * y, by_v * x, by_v * y])
        unit = ROOT_WEIGHT * (grey - grey @ weight)
        norm = np.linalg.norm(unit)
        unit /= norm
        steepest = ROOT_WEIGHT * (steepest - (steepest @ weight)[:, None]) / norm
        steepest -= np.outer(steepest @ unit, unit)
        H = steepest @ steepest.T
        H += np.eye(6) * (1e-3 * np.trace(H) / 6.0 + 1e-9)
        np.testing.assert_allclose(store.patches.grey[slot[n], :PIXELS], unit, atol=1e-4)
        np.testing.assert_allclose(steepest_of(store.patches)[slot[n]], steepest, atol=1e-4)
        scale = np.abs(np.linalg.inv(H)).max()
        np.testing.assert_allclose(
            store.patches.inverse[slot[n]], np.linalg.inv(H), atol=1e-3 * scale
        )
        assert not store.patches.grey[slot[n], PIXELS:].any()
