"""Which features go on, by the kernel and by its plain NumPy twin."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.frontend.feature_kernel import keep_found_compiled
from ovmot.frontend.preprocessing import NO_MASK, inside_mask
from ovmot.geometry.arrays import BoolArray, FloatArray

CAMERA = Camera.make((160, 100), (150.0, 150.0), (80.0, 50.0))
BORDER_PX, MAX_SCALE = 7, 1.7


def is_rescaled(warp: FloatArray) -> BoolArray:
    scale = np.linalg.svd(warp, compute_uv=False)
    return np.asarray((scale[:, 0] > MAX_SCALE) | (scale[:, 1] < 1.0 / MAX_SCALE))


@pytest.mark.parametrize("masked", [True, False])
def test_kept_features(masked: bool) -> None:
    rng = np.random.default_rng(0)
    n = 400
    uv = rng.uniform(-5.0, 165.0, (n, 2))
    uv[:4] = [[7.0, 7.0], [152.0, 92.0], [6.99, 30.0], [30.0, 92.01]]
    xy, warp = CAMERA.normalize(uv), np.eye(2) + rng.normal(0.0, 0.4, (n, 2, 2))
    xy[5:20] = np.nan
    found, fits = rng.uniform(size=n) < 0.8, rng.uniform(size=n) < 0.7
    mask = np.zeros((100, 160), dtype=np.uint8)
    mask[40:60, 50:] = 255
    row, stale = keep_found_compiled(
        uv, xy, warp, found, fits, mask if masked else NO_MASK, 160, 100, BORDER_PX, MAX_SCALE
    )
    expected = found & np.isfinite(xy[:, 0]) & CAMERA.inside(uv, BORDER_PX)
    expected &= ~inside_mask(uv, mask if masked else None)
    np.testing.assert_array_equal(row, np.flatnonzero(expected))
    np.testing.assert_array_equal(stale, (~fits | is_rescaled(warp))[expected])
    assert 0 < stale.sum() < len(row)


def test_a_patch_is_rescaled_along_any_direction() -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    warps = [np.eye(2), turn, turn @ np.diag([1.0, 1.8]), turn @ np.diag([0.55, 1.0]) @ turn.T]
    uv, ok = np.full((4, 2), 50.0), np.ones(4, dtype=np.bool_)
    _, stale = keep_found_compiled(
        uv, uv, np.array(warps), ok, ok, NO_MASK, 160, 100, BORDER_PX, MAX_SCALE
    )
    np.testing.assert_array_equal(stale, [False, False, True, True])
