"""The gate and the two-view test on exact geometry: any lens, lines in any direction."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.epipolar import (
    SCALES,
    epipolar_lines,
    gate_matches,
    match_sigma,
    no_matches,
    two_view_inliers,
)
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.physics import LEAST_MATCH_SIGMA_PX, epipolar_pixel_sigma
from ovmot.settings import EpipolarSettings
from ovmot.types import StereoMatches

LENSES = {
    "none": [],
    "radtan": [-0.28, 0.07, 2e-4, -3e-4],
    "equidistant": [-0.01, 0.02, -0.015, 0.004],
}
ANGLE = EpipolarSettings(threshold_px=1.5, scale="angle")
FY = EpipolarSettings(threshold_px=1.5, scale="fy")
FOCAL = 400.0
THRESHOLD = 1.0 / FOCAL


def rotated_rig(lens: str, focal: tuple[float, float] = (420.0, 310.0)) -> StereoRig:
    """The right camera rolled by -25 degrees, squinting a little, displaced diagonally."""
    camera = Camera.make((752, 480), focal, (370.0, 245.0), lens, LENSES[lens])
    roll = so3.exp(np.array([0.0, 0.0, np.radians(-25.0)])) @ so3.exp(np.array([0.03, -0.05, 0.0]))
    return StereoRig(camera, camera, np.eye(4), se3.make(roll, np.array([0.3, 0.25, 0.05])))


def level_rig() -> StereoRig:
    camera = Camera.make((752, 480), (420.0, 310.0), (370.0, 245.0))
    return StereoRig(camera, camera, np.eye(4), se3.make(np.eye(3), np.array([0.3, 0.0, 0.0])))


def true_matches(rig: StereoRig, n: int = 200) -> FloatArray:
    """Pixels (N, 4) of points that both cameras see."""
    rng = np.random.default_rng(1)
    z = rng.uniform(2.0, 40.0, n)
    p = np.column_stack([rng.uniform(-0.5, 0.5, n) * z, rng.uniform(-0.4, 0.4, n) * z, z])
    left = rig.cam0.project(p)
    right = rig.cam1.project(se3.apply(rig.T_cam1_cam0, p))
    inside = rig.cam0.inside(left) & rig.cam1.inside(right)
    assert inside.sum() > n // 3
    return np.concatenate([left, right], axis=1)[inside]


def gate(rig: StereoRig, pixels: FloatArray, settings: EpipolarSettings) -> StereoMatches:
    normalized = np.concatenate(
        [rig.cam0.normalize(pixels[:, :2]), rig.cam1.normalize(pixels[:, 2:])], axis=1
    )
    return gate_matches(np.arange(len(pixels)), pixels, normalized, rig, settings)[1]


def along_normals(rig: StereoRig, pixels: FloatArray, off: FloatArray) -> FloatArray:
    """The matches with their right points moved by `off` (N,) pixels along the lines' normals.

    The line a x + b y + c = 0 of the plane is (a/fx) u + (b/fy) v + ... = 0 in the image.
    """
    lines = epipolar_lines(rig.cam0.normalize(pixels[:, :2]), rig.essential)
    normal = lines[:, :2] / (rig.cam1.fx, rig.cam1.fy)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = pixels.copy()
    out[:, 2:] += off[:, None] * normal
    return out


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("settings", [ANGLE, FY])
def test_true_matches_lie_on_their_lines(lens: str, settings: EpipolarSettings) -> None:
    rig = rotated_rig(lens)
    matches = gate(rig, true_matches(rig), settings)
    assert matches.accepted.all()
    assert matches.distance_px.max() < 1e-6
    tilt = np.degrees(np.arctan2(np.abs(matches.line[:, 0]), np.abs(matches.line[:, 1])))
    assert np.median(tilt) > 45.0  # the lines are far from horizontal
    np.testing.assert_allclose(np.hypot(matches.line[:, 0], matches.line[:, 1]), 1.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_distance_is_in_pixels_along_the_normal(sign: float) -> None:
    rig = rotated_rig("none")
    pixels = true_matches(rig)
    off = np.random.default_rng(2).uniform(0.1, 5.0, len(pixels))
    matches = gate(rig, along_normals(rig, pixels, sign * off), ANGLE)
    np.testing.assert_allclose(matches.distance_px, off, atol=1e-6)
    np.testing.assert_array_equal(matches.accepted, off <= 1.5)
    assert 0 < matches.accepted.sum() < len(pixels)


@pytest.mark.parametrize("lens", ["radtan", "equidistant"])
def test_a_lens_changes_the_distance_only_by_its_own_magnification(lens: str) -> None:
    """Right beside the middle, where the lens does next to nothing, d pixels are d pixels."""
    rig = rotated_rig(lens)
    pixels = true_matches(rig, 4000)
    middle = np.hypot(pixels[:, 2] - 370.0, pixels[:, 3] - 245.0) < 40.0
    assert middle.sum() > 10
    matches = gate(rig, along_normals(rig, pixels[middle], np.full(middle.sum(), 2.0)), ANGLE)
    np.testing.assert_allclose(matches.distance_px, 2.0, rtol=0.03)
    assert not matches.accepted.any()


def test_a_match_moved_along_its_line_is_accepted() -> None:
    rig = rotated_rig("none")
    pixels = true_matches(rig)
    along = along_normals(rig, pixels, np.ones(len(pixels)))[:, 2:] - pixels[:, 2:]
    drifted = pixels.copy()
    drifted[:, 2:] += 20.0 * np.column_stack([-along[:, 1], along[:, 0]])
    assert gate(rig, drifted, ANGLE).distance_px.max() < 1e-6


def test_both_scales_agree_on_horizontal_lines() -> None:
    rig = level_rig()
    pixels = true_matches(rig)
    pixels[:, 3] += np.random.default_rng(3).normal(0.0, 1.5, len(pixels))
    by_angle, by_fy = gate(rig, pixels, ANGLE), gate(rig, pixels, FY)
    np.testing.assert_allclose(by_angle.distance_px, by_fy.distance_px, rtol=1e-12)
    np.testing.assert_allclose(by_angle.distance_px, np.abs(pixels[:, 3] - pixels[:, 1]), atol=1e-9)
    np.testing.assert_array_equal(by_angle.accepted, by_fy.accepted)


def test_the_scales_differ_on_sloped_lines_by_their_definition() -> None:
    rig = rotated_rig("none")
    off = np.full(len(true_matches(rig)), 1.4)
    pixels = along_normals(rig, true_matches(rig), off)
    by_angle, by_fy = gate(rig, pixels, ANGLE), gate(rig, pixels, FY)
    a, b = by_angle.line[:, 0], by_angle.line[:, 1]
    expected = 1.4 * np.hypot(a / 420.0, b / 310.0) * 310.0
    np.testing.assert_allclose(by_fy.distance_px, expected, atol=1e-6)
    assert np.abs(by_fy.distance_px - by_angle.distance_px).max() > 0.1
    np.testing.assert_array_equal(SCALES["fy"](rig.cam1), [310.0, 310.0])
    np.testing.assert_array_equal(SCALES["angle"](rig.cam1), [420.0, 310.0])


@pytest.mark.parametrize("column", [1, 3])
def test_nan_is_rejected(column: int) -> None:
    rig = rotated_rig("radtan")
    pixels = true_matches(rig)[:5]
    pixels[2, column] = np.nan
    assert gate(rig, pixels, ANGLE).accepted.tolist() == [True, True, False, True, True]


@pytest.mark.parametrize("camera", [0, 1])
def test_what_one_camera_does_not_see_is_not_tested(camera: int) -> None:
    rig = rotated_rig("radtan")
    pixels = true_matches(rig)[:5]
    pixels[2, 2 * camera : 2 * camera + 2] = np.nan
    matches = gate(rig, pixels, ANGLE)
    assert matches.feature_id.tolist() == [0, 1, 3, 4]
    np.testing.assert_array_equal(matches.pixels, np.delete(pixels, 2, axis=0))


def test_a_pixel_past_the_lens_s_fold_is_rejected() -> None:
    camera = Camera.make((752, 480), (420.0, 420.0), (370.0, 245.0), "radtan", [-0.5, 0.0, 0, 0])
    rig = StereoRig(camera, camera, np.eye(4), se3.make(np.eye(3), np.array([0.3, 0.0, 0.0])))
    pixels = np.array([[380.0, 245.0, 370.0, 245.0], [380.0, 245.0, 5.0, 5.0]])
    assert np.isnan(camera.normalize(pixels[1, 2:])).all()
    assert gate(rig, pixels, ANGLE).accepted.tolist() == [True, False]


def test_the_threshold_is_respected() -> None:
    rig = level_rig()
    pixels = np.repeat(true_matches(rig)[:1], 3, axis=0)
    pixels[:, 3] += [0.0, 2.9, 3.1]
    settings = EpipolarSettings(threshold_px=3.0, scale="angle")
    assert gate(rig, pixels, settings).accepted.tolist() == [True, True, False]
    assert gate(rig, pixels, ANGLE).accepted.tolist() == [True, False, False]


def test_a_rejected_match_loses_its_right_half_only() -> None:
    rig = level_rig()
    pixels = true_matches(rig)[:4]
    pixels[1, 3] += 10.0
    gated, _ = gate_matches(np.arange(4), pixels, rig.normalize(pixels), rig, ANGLE)
    out = gated.pixels
    assert np.isnan(gated.normalized[:, 2]).tolist() == [False, True, False, False]
    assert np.isnan(gated.p_cam0).any(axis=1).tolist() == [False, True, False, False]
    np.testing.assert_array_equal(out[:, :2], pixels[:, :2])
    assert np.isnan(out[:, 2]).tolist() == [False, True, False, False]
    assert np.isnan(out[:, 3]).tolist() == [False, True, False, False]
    np.testing.assert_array_equal(out[[0, 2, 3]], pixels[[0, 2, 3]])
    assert np.isfinite(pixels).all()  # the argument is left as it was


def distances(px: FloatArray, threshold: float = 1.5) -> StereoMatches:
    n = len(px)
    return StereoMatches(
        np.arange(n), np.zeros((n, 4)), px, px <= threshold, np.zeros((n, 3))
    )  # fmt: skip


def test_the_noise_of_pixels_is_that_of_the_distances() -> None:
    """Of both pixels in quadrature; a distance across the line holds all of it."""
    normal = np.abs(np.random.default_rng(0).normal(0.0, 0.3 * 2.0**0.5, 20000))
    assert epipolar_pixel_sigma(distances(normal).distance_px, tails=1.0) == pytest.approx(
        0.3, rel=0.02
    )
    assert match_sigma(distances(normal)) == pytest.approx(0.45, rel=0.02)
    # a few gross errors hardly matter, rejected matches do not count
    gross = np.concatenate([normal, np.full(400, 1.4)])
    assert match_sigma(distances(gross)) == pytest.approx(0.45, rel=0.05)
    wrong = np.concatenate([normal, np.full(9000, 50.0)])
    assert match_sigma(distances(wrong)) == match_sigma(distances(normal))


def test_few_matches_show_no_noise_and_exact_ones_the_least() -> None:
    assert np.isnan(match_sigma(no_matches()))
    assert np.isnan(match_sigma(distances(np.full(19, 0.2))))
    assert epipolar_pixel_sigma(np.zeros(20), tails=1.0) == LEAST_MATCH_SIGMA_PX


def scene(n: int, T_now_before: FloatArray, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Normalized coordinates (N, 2) before and now of static points, with 0.1 px of noise."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(4.0, 30.0, n)
    p = np.column_stack([rng.uniform(-0.8, 0.8, n) * z, rng.uniform(-0.5, 0.5, n) * z, z])
    q = se3.apply(T_now_before, p)
    noise = rng.normal(0.0, 0.1 / FOCAL, (2, n, 2))
    return p[:, :2] / z[:, None] + noise[0], q[:, :2] / q[:, 2:] + noise[1]


@pytest.fixture
def motion() -> FloatArray:
    """Forward and a little to the side, with a turn."""
    return se3.make(so3.exp(np.array([0.01, -0.03, 0.005])), np.array([0.1, 0.02, -0.6]))


def test_static_points_pass(motion: FloatArray) -> None:
    before, now = scene(150, motion)
    assert two_view_inliers(before, now, motion[:3, :3], THRESHOLD).mean() > 0.95


def test_moved_points_are_rejected(motion: FloatArray) -> None:
    """Where a point goes off its epipolar line the test sees it; along it, it can not."""
    before, now = scene(150, motion)
    E = so3.hat(motion[:3, 3]) @ motion[:3, :3]
    line = np.concatenate([before, np.ones((150, 1))], axis=1) @ E.T
    normal = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    now[:30] += 8.0 / FOCAL * normal[:30]
    passed = two_view_inliers(before, now, motion[:3, :3], THRESHOLD)
    assert passed[:30].mean() < 0.1
    assert passed[30:].mean() > 0.95


def test_a_moving_minority_does_not_win(motion: FloatArray) -> None:
    """A body of 40 points on a motion of its own, among 110 static points."""
    before, now = scene(150, motion)
    own = se3.make(np.eye(3), np.array([1.5, 0.8, -0.2]))
    before[:40], now[:40] = scene(40, own, seed=7)
    passed = two_view_inliers(before, now, motion[:3, :3], THRESHOLD)
    assert passed[:40].mean() < 0.3
    assert passed[40:].mean() > 0.9


def test_with_few_points_it_knows_nothing_and_passes_all(motion: FloatArray) -> None:
    before, now = scene(11, motion)
    now[:5] += 0.2
    assert two_view_inliers(before, now, motion[:3, :3], THRESHOLD).all()
    nothing = np.empty((0, 2))
    assert two_view_inliers(nothing, nothing, motion[:3, :3], THRESHOLD).shape == (0,)


def test_without_any_common_motion_all_pass() -> None:
    rng = np.random.default_rng(2)
    before, now = rng.uniform(-0.8, 0.8, (2, 15, 2))
    passed = two_view_inliers(before, now, np.eye(3), 1e-6)
    assert passed.all()


def test_nan_does_not_pass(motion: FloatArray) -> None:
    before, now = scene(60, motion)
    now[4] = np.nan
    before[9, 1] = np.nan
    passed = two_view_inliers(before, now, motion[:3, :3], THRESHOLD)
    assert not passed[[4, 9]].any()
    assert passed.mean() > 0.9
    few_before, few_now = before[:10], now[:10]
    assert not two_view_inliers(few_before, few_now, motion[:3, :3], THRESHOLD)[[4, 9]].any()


def test_the_verdict_does_not_change_from_run_to_run(motion: FloatArray) -> None:
    before, now = scene(150, motion)
    now[:60] += np.random.default_rng(1).uniform(-0.02, 0.02, (60, 2))
    first = two_view_inliers(before, now, motion[:3, :3], THRESHOLD)
    for _ in range(5):
        np.testing.assert_array_equal(
            two_view_inliers(before, now, motion[:3, :3], THRESHOLD), first
        )


def test_a_stationary_camera_keeps_static_points() -> None:
    before, _ = scene(100, np.eye(4))
    now = before + np.random.default_rng(3).normal(0.0, 0.05 / FOCAL, before.shape)
    assert two_view_inliers(before, now, np.eye(3), THRESHOLD).mean() > 0.95


def test_pairs_without_any_motion_are_no_trouble() -> None:
    """All rays of now are those of before: no two of them determine a translation."""
    before, _ = scene(50, np.eye(4))
    assert two_view_inliers(before, before, np.eye(3), THRESHOLD).all()


def test_a_wrong_rotation_leaves_points_out(motion: FloatArray) -> None:
    """By three degrees, 24 px: the test takes the predicted rotation as it is."""
    before, now = scene(150, motion)
    wrong = so3.exp(np.array([0.0, 0.05, 0.0])) @ motion[:3, :3]
    assert two_view_inliers(before, now, wrong, THRESHOLD).mean() < 0.7


def test_the_kernel_is_its_plain_twin(motion: FloatArray) -> None:
    """Its inliers are those of the translation that it ends with, which is near the true one."""
    before, now = scene(150, motion)
    now[:40] += np.random.default_rng(5).uniform(-0.05, 0.05, (40, 2))
    R, t = motion[:3, :3], motion[:3, 3] / np.linalg.norm(motion[:3, 3])
    ones = np.ones((150, 1))
    x0, x1 = np.hstack([before, ones]), np.hstack([now, ones])
    essential = so3.hat(t) @ R
    line_now, line_before = x0 @ essential.T, x1 @ essential
    size = np.sqrt((line_now[:, :2] ** 2).sum(1) + (line_before[:, :2] ** 2).sum(1))
    expected = np.abs((x1 * line_now).sum(1)) / size <= THRESHOLD
    assert (two_view_inliers(before, now, R, THRESHOLD) == expected).mean() > 0.97
