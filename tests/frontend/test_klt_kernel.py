"""The compiled flow equals OpenCV's, of which it is the twin."""

import cv2
import numpy as np
import pytest

from ovmot.frontend import klt_kernel
from ovmot.frontend.feature_kernel import LOST, find_features_compiled
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import build_pyramid, patch_image
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.settings import TrackerSettings

WINDOW = 11
SETTINGS = TrackerSettings(klt_window_px=WINDOW, klt_levels=5)
SIZE = (300, 220)
_STOP = (
    cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT,
    klt_kernel.MAX_STEPS,
    klt_kernel.SMALL_STEP_PX,
)


def painted(shift: tuple[float, float], turn_deg: float) -> Image:
    """Blobs and a flat corner, moved."""
    noise = np.random.default_rng(5).standard_normal((SIZE[1], SIZE[0]))
    soft = cv2.GaussianBlur(noise, (0, 0), 1.8)
    grey = 128.0 + 45.0 * soft / soft.std()
    grey[:70, :90] = 90.0
    M = cv2.getRotationMatrix2D((150.0, 110.0), turn_deg, 1.0)
    M[:, 2] += np.array(shift)
    moved = cv2.warpAffine(grey, M, SIZE, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(np.clip(np.round(moved), 0, 255), dtype=np.uint8)


def by_flow_alone(
    source: Image, target: Image, points: FloatArray, start: FloatArray, n_levels: int
) -> tuple[FloatArray, BoolArray]:
    """The search for features with patches that are never alike enough."""
    never = 2.0
    store = PatchStore()
    slot = store.add(patch_image(source), points)
    n = len(points)
    uv, warp, state = start.copy(), store.warp[slot], np.zeros(n, dtype=np.uint8)
    find_features_compiled(
        build_pyramid(source, SETTINGS).levels, build_pyramid(target, SETTINGS).levels,
        patch_image(target), WINDOW, store.patches, slot, store.warp, points,
        np.arange(n), start[None], np.full((1, n), n_levels), False,
        never, never, 8, 0.02, uv, warp, state,
    )  # fmt: skip
    return uv, state != LOST


def by_opencv(
    source: Image, target: Image, points: FloatArray, start: FloatArray, n_levels: int
) -> tuple[FloatArray, BoolArray]:
    p, q = points.astype(np.float32), start.astype(np.float32)
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        source, target, p, q, winSize=(WINDOW, WINDOW), maxLevel=n_levels - 1, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=1e-3,
    )  # fmt: skip
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(
        target, source, there, p.copy(), winSize=(WINDOW, WINDOW),
        maxLevel=klt_kernel.BACK_LEVELS - 1, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=1e-3,
    )  # fmt: skip
    returned = np.linalg.norm(back - p, axis=1) < klt_kernel.MAX_ROUND_TRIP_PX
    ok = (found.ravel() == 1) & (found_back.ravel() == 1) & returned
    return there.astype(np.float64), ok


def well_inside(points: FloatArray) -> BoolArray:
    return np.asarray(((points > 40.0) & (points < np.array(SIZE) - 40.0)).all(axis=1))


@pytest.mark.parametrize("n_levels", [1, 3, 5])
@pytest.mark.parametrize(("shift", "turn_deg"), [((1.3, -0.6), 0.0), ((7.25, 4.5), 1.5)])
def test_it_finds_what_opencv_finds(
    n_levels: int, shift: tuple[float, float], turn_deg: float
) -> None:
    """On textured and flat ground, up to the border; only what is in doubt may differ. Nothing is
    sought outside the image."""
    source, target = painted((0.0, 0.0), 0.0), painted(shift, turn_deg)
    rng = np.random.default_rng(2)
    points = rng.uniform([-4.0, -4.0], [304.0, 224.0], (600, 2))
    start = points + 0.8 * np.array(shift) + rng.uniform(-1.0, 1.0, points.shape)
    expected = by_opencv(source, target, points, start, n_levels)
    uv, found = by_flow_alone(source, target, points, start, n_levels)
    inside = ((start >= 0.0) & (start < np.array(SIZE))).all(axis=1)
    assert not found[~inside].any()
    expected[1][~inside] = False
    assert expected[1].mean() > 0.5
    assert (~expected[1]).mean() > 0.05
    assert (found != expected[1]).mean() < 0.02
    both = found & expected[1]
    off = np.linalg.norm(uv - expected[0], axis=1)[both]
    assert np.median(off) < 1e-3
    assert (
        np.quantile(off[well_inside(points[both])], 0.99) < 0.01
    )  # at the border half of it is lost
    assert np.quantile(off, 0.9) < 0.02


def test_wild_starts_are_not_found() -> None:
    source = painted((0.0, 0.0), 0.0)
    points = np.array([[150.0, 150.0], [1e9, 3.0], [150.0, 150.0], [-1e9, 1e9]])
    start = np.array([[1e12, 1e12], [5.0, 5.0], [-1e9, 150.0], [1e9, -1e9]])
    _, found = by_flow_alone(source, source, points, start, 5)
    assert not found.any()
