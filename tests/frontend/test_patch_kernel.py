"""The compiled alignment equals its plain NumPy twin."""

import cv2
import numpy as np

from ovmot.frontend.patch_kernel import align_points, align_points_compiled
from ovmot.frontend.patches import Patches, cut_patches
from ovmot.frontend.preprocessing import smoothed
from ovmot.geometry.arrays import AnyArray, FloatArray, Image

STEPS, SMALL, FAR = 8, 0.02, 3.0
RADIUS = 6
OFFSETS = np.indices((13, 13), dtype=np.float32)[::-1].reshape(2, -1) - RADIUS
ROOT_WEIGHT = np.exp(
    -0.25 * np.add.outer(np.arange(-6.0, 7.0) ** 2, np.arange(-6.0, 7.0) ** 2).ravel() / 9.0
).astype(np.float32)


def painted(seed: int) -> Image:
    noise = np.random.default_rng(seed).standard_normal((120, 160))
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(np.clip(128.0 + 45.0 * soft / soft.std(), 0, 255), dtype=np.uint8)


def twin(
    image: AnyArray, patches: Patches, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All points at once, in NumPy."""
    axis = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
    offsets = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    uv, warp = start.copy(), patches.warp.copy()
    correlation, going = np.zeros(len(uv)), np.arange(len(uv))
    weight = (ROOT_WEIGHT.astype(np.float64) ** 2) / (ROOT_WEIGHT.astype(np.float64) ** 2).sum()
    for _ in range(STEPS):
        where = uv[going, None] + offsets @ np.swapaxes(warp[going], 1, 2)
        where = np.clip(where, 0.0, np.array(image.shape[::-1]) - 1.0)
        corner = np.minimum(where.astype(int), np.array(image.shape[::-1]) - 2)
        a, b = np.moveaxis(where - corner, -1, 0)
        u, v = np.moveaxis(corner, -1, 0)
        grey = image.astype(np.float64)
        above = (1 - a) * grey[v, u] + a * grey[v, u + 1]
        below = (1 - a) * grey[v + 1, u] + a * grey[v + 1, u + 1]
        seen = (1 - b) * above + b * below
        seen = (seen - (seen * weight).sum(1, keepdims=True)) * ROOT_WEIGHT
        seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-3)
        error = seen - patches.grey[going]
        correlation[going] = 1.0 - 0.5 * (error**2).sum(1)
        step = np.einsum("nij,njm,nm->ni", patches.inverse[going], patches.steepest[going], error)
        change = np.eye(2) + step[:, 2:].reshape(-1, 2, 2) / RADIUS
        warp[going] = warp[going] @ np.linalg.inv(change)
        uv[going] -= (warp[going] @ step[:, :2, None])[..., 0]
        near = np.linalg.norm(uv[going] - start[going], axis=1) < FAR
        going = going[near & (np.abs(step).max(axis=1) > SMALL)]
    return uv, warp, correlation


def test_compiled_and_plain_code_agree_with_the_twin() -> None:
    source = smoothed(painted(1))
    target = smoothed(np.roll(painted(1), (1, 2), axis=(0, 1)))
    rng = np.random.default_rng(3)
    points = rng.uniform([2.0, 2.0], [157.0, 117.0], (40, 2))  # some at the border
    points[7] = np.nan
    patches = cut_patches(source, np.nan_to_num(points, nan=50.0))
    start = points + np.array([1.4, 0.7])
    known = np.isfinite(start[:, 0])
    expected = twin(target, patches.rows(known), start[known])
    for function in (align_points, align_points_compiled):
        uv, warp = start.copy(), patches.warp.copy()
        correlation = function(
            target, patches.grey, patches.steepest, patches.inverse, ROOT_WEIGHT, OFFSETS,
            uv, warp, STEPS, SMALL, FAR,
        )  # fmt: skip
        assert np.isnan(uv[7]).all()
        assert correlation[7] == 0.0
        np.testing.assert_allclose(uv[known], expected[0], atol=1e-4)
        np.testing.assert_allclose(warp[known], expected[1], atol=1e-4)
        np.testing.assert_allclose(correlation[known], expected[2], atol=1e-4)
    assert (expected[2] > 0.9).mean() > 0.5
