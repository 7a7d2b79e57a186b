"""The robust test between two left views, on exact geometry with a little noise."""

import numpy as np
import pytest

from ovmot.frontend.two_view import two_view_inliers
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

FOCAL = 400.0
THRESHOLD = 1.0 / FOCAL


def scene(n: int, T_now_before: FloatArray, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Plane coordinates (N, 2) before and now of points at rest, with 0.1 px of noise."""
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


def test_points_at_rest_pass(motion: FloatArray) -> None:
    before, now = scene(150, motion)
    assert two_view_inliers(before, now, THRESHOLD).mean() > 0.95


def test_moved_points_are_refused(motion: FloatArray) -> None:
    """Where a point goes off its epipolar line the test sees it; along it, it can not."""
    before, now = scene(150, motion)
    E = so3.hat(motion[:3, 3]) @ motion[:3, :3]
    line = np.concatenate([before, np.ones((150, 1))], axis=1) @ E.T
    normal = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    now[:30] += 8.0 / FOCAL * normal[:30]
    passed = two_view_inliers(before, now, THRESHOLD)
    assert passed[:30].mean() < 0.1
    assert passed[30:].mean() > 0.95


def test_a_moving_minority_does_not_win(motion: FloatArray) -> None:
    """A body of 40 points on a motion of its own, among 110 points at rest."""
    before, now = scene(150, motion)
    own = se3.make(np.eye(3), np.array([1.5, 0.8, -0.2]))
    before[:40], now[:40] = scene(40, own, seed=7)
    passed = two_view_inliers(before, now, THRESHOLD)
    assert passed[:40].mean() < 0.3
    assert passed[40:].mean() > 0.9


def test_with_few_points_it_knows_nothing_and_passes_all(motion: FloatArray) -> None:
    before, now = scene(11, motion)
    now[:5] += 0.2
    assert two_view_inliers(before, now, THRESHOLD).all()
    nothing = np.empty((0, 2))
    assert two_view_inliers(nothing, nothing, THRESHOLD).shape == (0,)


def test_without_any_common_motion_all_pass() -> None:
    rng = np.random.default_rng(2)
    before, now = rng.uniform(-0.8, 0.8, (2, 15, 2))
    passed = two_view_inliers(before, now, 1e-6)
    assert passed.all()


def test_nan_does_not_pass(motion: FloatArray) -> None:
    before, now = scene(60, motion)
    now[4] = np.nan
    before[9, 1] = np.nan
    passed = two_view_inliers(before, now, THRESHOLD)
    assert not passed[[4, 9]].any()
    assert passed.mean() > 0.9
    few_before, few_now = before[:10], now[:10]
    assert not two_view_inliers(few_before, few_now, THRESHOLD)[[4, 9]].any()


def test_the_verdict_does_not_change_from_run_to_run(motion: FloatArray) -> None:
    before, now = scene(150, motion)
    now[:60] += np.random.default_rng(1).uniform(-0.02, 0.02, (60, 2))
    first = two_view_inliers(before, now, THRESHOLD)
    for _ in range(5):
        np.testing.assert_array_equal(two_view_inliers(before, now, THRESHOLD), first)


def test_a_standing_camera_keeps_what_stands() -> None:
    before, _ = scene(100, np.eye(4))
    now = before + np.random.default_rng(3).normal(0.0, 0.05 / FOCAL, before.shape)
    assert two_view_inliers(before, now, THRESHOLD).mean() > 0.95


@pytest.mark.parametrize("seed", [1208, 1287, 1437, 1674])
def test_noise_on_which_the_solver_gives_up_is_no_failure(seed: int) -> None:
    rng = np.random.default_rng(seed)  # OpenCV 4.14 raises on these: "!model.empty()"
    before = rng.uniform(-0.7, 0.7, (100, 2))
    now = before + rng.normal(0.0, 1.0 / 458, before.shape) * 2.0 + (seed % 40) * 1e-3
    assert two_view_inliers(before, now, 1.0 / 458).all()
