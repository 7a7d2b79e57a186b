"""Scans along epipolar curves: against a plain NumPy twin, and on what repeats itself."""

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.lens_kernel import packed_camera
from ovmot.frontend.epipolar_scan_kernel import HALF, ScanRules, scan_curves_compiled
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray

MARGIN = 13
RULES = ScanRules(least_depth=2.0, least=0.7, ratio=0.8, noise=2.0)
BENT = Camera.make(
    (320, 240), (250.0, 250.0), (160.0, 120.0), "radtan", [-0.25, 0.06, 0.0, 0.0]
)  # fmt: skip


def padded(image: Image) -> Image:
    grown = cv2.copyMakeBorder(image, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REFLECT_101)
    return np.asarray(grown, dtype=np.uint8)


def texture(seed: int, height: int, width: int) -> Image:
    rng = np.random.default_rng(seed)
    grey = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (height, width)), (0, 0), 0.8)
    return np.asarray(np.clip(128.0 + 4.0 * (grey - 128.0), 0.0, 255.0), dtype=np.uint8)


def scanned(
    left: Image, right: Image, uv: FloatArray, T: FloatArray, camera: Camera
) -> tuple[FloatArray, BoolArray]:
    """By images of half the camera's size."""
    return scan_curves_compiled(
        padded(left), padded(right), MARGIN, uv, camera.normalize(uv), np.ones(len(uv), np.bool_),
        T, *packed_camera(camera), RULES,
    )  # fmt: skip


def correlations(left: Image, right: Image, u: int, v: int, columns: IntArray) -> FloatArray:
    """Of the window around (u, v) of the left image with those in the same row of the right one."""
    rows = slice(v - HALF, v + HALF + 1)
    a, scores = left[rows, u - HALF : u + HALF + 1].astype(np.float64), []
    for x in columns.tolist():
        b = right[rows, x - HALF : x + HALF + 1].astype(np.float64)
        scores.append(np.corrcoef(a.ravel(), b.ravel())[0, 1])
    return np.array(scores)


def test_best_and_second_best_place_are_those_of_all_correlations() -> None:
    """The plain twin for pinholes side by side, where a curve is a row of the image."""
    camera = Camera.make((320, 240), (250.0, 250.0), (160.0, 120.0))
    left, other = texture(6, 120, 160), texture(7, 120, 160)
    right = np.asarray(0.7 * np.roll(left, -7, axis=1) + 0.3 * other, dtype=np.uint8)
    T, n_placed = se3.make(np.eye(3), np.array([-0.3, 0.0, 0.0])), 0
    for u, v in [(60, 30), (75, 100), (90, 44), (110, 60), (130, 20), (140, 81), (100, 88)]:
        uv = 2.0 * np.array([[u, v]], np.float64)
        found, ambiguous = scanned(left, right, uv, T, camera)
        reach = 0.5 * 250.0 * 0.3 / RULES.least_depth  # half-size pixels of disparity
        columns = np.arange(int(np.floor(u - reach)) - 1, u + 2)
        score = correlations(left, right, u, v, columns)
        peaks = []
        for k in range(1, len(score) - 1):
            before, here, after = score[k - 1 : k + 2]
            if here >= before and here > after:
                bend, slope = before - 2.0 * here + after, 0.5 * (after - before)
                height = min(here - 0.5 * slope**2 / bend, 1.0)
                peaks.append((height, columns[k] - slope / bend))
        (best, place), (second, _) = sorted([*peaks, (-1.0, 0.0), (-1.0, 0.0)])[:-3:-1]
        assert np.isfinite(found[0]).all() == (best >= RULES.least)
        if best < RULES.least:
            continue
        n_placed += 1
        np.testing.assert_allclose(0.5 * found[0], (place, v), atol=1e-3)
        window = left[v - HALF : v + HALF + 1, u - HALF : u + HALF + 1]
        blur = RULES.noise**2 / window.astype(np.float64).var()
        assert ambiguous[0] == (1.0 - best + blur > RULES.ratio**2 * (1.0 - second + blur))
    assert n_placed > 3


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_window_is_found_where_it_lies_on_the_curve(share: float) -> None:
    """Through a lens that bends the curves, from cameras that are turned against each other."""
    T = se3.make(so3.exp(np.array([0.01, -0.02, 0.03])), np.array([-0.3, 0.02, 0.01]))
    left, other = texture(1, 120, 160), texture(2, 120, 160)
    for u, v in [(80.0, 60.0), (60.0, 30.0), (120.0, 95.0), (100.0, 15.0), (140.0, 60.0)]:
        uv = 2.0 * np.array([[u, v]])  # the centre of a half-size pixel
        ray = T[:3, :3] @ [*BENT.normalize(uv)[0], 1.0] + share / RULES.least_depth * T[:3, 3]
        x, y = np.round(0.5 * BENT.denormalize(ray[:2] / ray[2])).astype(int)
        right, r = other.copy(), HALF + 2
        right[y - r : y + r + 1, x - r : x + r + 1] = left[
            int(v) - r : int(v) + r + 1, int(u) - r : int(u) + r + 1
        ]
        found, ambiguous = scanned(left, right, uv, T, BENT)
        np.testing.assert_allclose(found[0], (2.0 * x, 2.0 * y), atol=1.5)
        assert not ambiguous[0]


@pytest.mark.parametrize("upright", [False, True])
def test_a_pair_side_by_side_or_one_above_the_other(upright: bool) -> None:
    camera = Camera.make((320, 320), (250.0, 250.0), (160.0, 160.0))
    scene = texture(3, 180, 180)
    left = scene[:160, :160]
    right = scene[9:169, :160] if upright else scene[:160, 9:169]
    shift = np.array([0.0, 18.0]) if upright else np.array([18.0, 0.0])
    t = np.array([0.0, -0.3, 0.0]) if upright else np.array([-0.3, 0.0, 0.0])
    uv = np.array([[100.0, 120.0], [201.0, 203.0], [253.0, 90.0]])
    found, ambiguous = scanned(left, right, uv, se3.make(np.eye(3), t), camera)
    np.testing.assert_allclose(found, uv - shift, atol=0.5)
    assert not ambiguous.any()


def test_what_repeats_itself_is_ambiguous_and_what_fits_nowhere_has_no_place() -> None:
    camera = Camera.make((320, 240), (250.0, 250.0), (160.0, 120.0))
    tile = texture(4, 120, 14)
    left, right = np.tile(tile, 12)[:, :160], np.tile(tile, 12)[:, 4:164]
    uv, T = np.array([[160.0, 120.0], [240.0, 80.0]]), se3.make(np.eye(3), np.array([-0.3, 0, 0]))
    found, ambiguous = scanned(left, right, uv, T, camera)
    assert np.isfinite(found).all() and ambiguous.all()
    found, ambiguous = scanned(left, texture(9, 120, 160), uv, T, camera)
    assert np.isnan(found).all() and not ambiguous.any()
    found, _ = scanned(left, right, np.array([[2.0, 3.0], [np.nan, np.nan]]), T, camera)
    assert np.isnan(found).all()


def test_what_is_not_wanted_is_not_sought() -> None:
    camera = Camera.make((320, 240), (250.0, 250.0), (160.0, 120.0))
    image, uv = padded(texture(5, 120, 160)), np.array([[160.0, 120.0], [240.0, 80.0]])
    found, _ = scan_curves_compiled(
        image, image, MARGIN, uv, camera.normalize(uv), np.array([True, False]),
        se3.make(np.eye(3), np.array([-0.3, 0.0, 0.0])), *packed_camera(camera), RULES,
    )  # fmt: skip
    np.testing.assert_allclose(found[0], uv[0], atol=0.5)
    assert np.isnan(found[1]).all()
