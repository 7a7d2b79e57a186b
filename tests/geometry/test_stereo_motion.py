"""The motion between two stereo views: found among outliers, with the covariance it claims."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.stereo_motion import solve_stereo_motion
from ovmot.geometry.triangulation import project_stereo

T_CAM1_CAM0 = se3.make(so3.exp(np.array([0.02, -0.03, 0.2])), np.array([-0.4, 0.05, 0.02]))
SIGMA = np.full(4, 0.5 / 500.0)
T_NOW_BEFORE = se3.exp(np.array([0.02, -0.05, 0.01, 0.1, -0.05, -0.6]))
ROTATION_SIGMA = 0.01


def stereo_pairs(
    rng: np.random.Generator, n: int, outliers: int = 0, scale: float = 1.0, far: float = 20.0
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Views (n, 4) before and now; the first `outliers` are on a car that drives on its own."""
    depth = rng.uniform(4.0, far, (n, 1))
    p = np.concatenate([rng.uniform(-0.6, 0.6, (n, 2)), np.ones((n, 1))], axis=1) * depth
    q = se3.apply(T_NOW_BEFORE, p)
    q[:outliers] += np.array([0.9, 0.0, 0.8])
    before, now = project_stereo(p, T_CAM1_CAM0)[0], project_stereo(q, T_CAM1_CAM0)[0]
    before = before + rng.normal(0.0, scale * SIGMA, before.shape)
    return before, now + rng.normal(0.0, scale * SIGMA, now.shape), np.arange(n) < outliers


def gyro_rotation(rng: np.random.Generator) -> FloatArray:
    return so3.exp(rng.normal(0.0, ROTATION_SIGMA, 3)) @ T_NOW_BEFORE[:3, :3]


def error_of(T: FloatArray) -> FloatArray:
    """(rotation, translation) of T_true = exp(δ) T, as `StereoMotion` has it."""
    return np.concatenate(
        [so3.log(T_NOW_BEFORE[:3, :3] @ T[:3, :3].T), T_NOW_BEFORE[:3, 3] - T[:3, 3]]
    )


@pytest.mark.parametrize("seed", range(5))
def test_motion_is_found_though_40_percent_drive_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, now, outlier = stereo_pairs(rng, 100, outliers=40)
    motion = solve_stereo_motion(
        before, now, T_CAM1_CAM0, gyro_rotation(rng), SIGMA, ROTATION_SIGMA
    )
    assert motion is not None
    e = error_of(motion.T_now_before)
    assert np.all(np.abs(e) < 4.0 * np.sqrt(np.diag(motion.covariance)))
    assert np.linalg.norm(e[3:]) < 0.02
    assert motion.inlier[~outlier].mean() > 0.95
    assert motion.inlier[outlier].mean() < 0.15


def test_covariance_is_about_right() -> None:
    rng = np.random.default_rng(42)
    errors, claims = [], []
    for _ in range(150):
        before, now, _ = stereo_pairs(rng, 60)
        motion = solve_stereo_motion(
            before, now, T_CAM1_CAM0, gyro_rotation(rng), SIGMA, ROTATION_SIGMA
        )
        assert motion is not None
        errors.append(error_of(motion.T_now_before))
        claims.append(motion.covariance)
    nees = np.array([e @ np.linalg.solve(C, e) for e, C in zip(errors, claims, strict=True)])
    assert 5.0 < nees.mean() < 7.0  # 6 of them


def test_far_points_do_not_shorten_the_motion() -> None:
    # 40 m at 0.4 m of baseline: depth scatters by a tenth, and not evenly
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(40):
        before, now, _ = stereo_pairs(rng, 100, far=40.0)
        motion = solve_stereo_motion(
            before, now, T_CAM1_CAM0, gyro_rotation(rng), SIGMA, ROTATION_SIGMA
        )
        assert motion is not None
        errors.append(error_of(motion.T_now_before)[5])
    assert abs(np.mean(errors)) < 0.001  # of 0.6 m


def test_points_without_stereo_are_no_inliers() -> None:
    rng = np.random.default_rng(1)
    before, now, _ = stereo_pairs(rng, 40)
    before[:5, 2:] = np.nan
    now[5:10, 2:] = np.nan
    motion = solve_stereo_motion(
        before, now, T_CAM1_CAM0, T_NOW_BEFORE[:3, :3], SIGMA, ROTATION_SIGMA
    )
    assert motion is not None
    assert not motion.inlier[:10].any()
    assert motion.inlier[10:].mean() > 0.9


def test_too_few_points_give_none() -> None:
    R = T_NOW_BEFORE[:3, :3]
    before, now, _ = stereo_pairs(np.random.default_rng(2), 8, scale=0.1)
    assert solve_stereo_motion(before, now, T_CAM1_CAM0, R, SIGMA, ROTATION_SIGMA) is not None
    assert solve_stereo_motion(before[1:], now[1:], T_CAM1_CAM0, R, SIGMA, ROTATION_SIGMA) is None
    now[0, 2:] = np.nan
    assert solve_stereo_motion(before, now, T_CAM1_CAM0, R, SIGMA, ROTATION_SIGMA) is None


def test_points_that_do_not_agree_give_none() -> None:
    rng = np.random.default_rng(3)
    before, _, _ = stereo_pairs(rng, 20)
    _, now, _ = stereo_pairs(rng, 20)  # other points
    R = T_NOW_BEFORE[:3, :3]
    assert solve_stereo_motion(before, now, T_CAM1_CAM0, R, SIGMA, ROTATION_SIGMA) is None


def test_no_motion_where_a_wide_gate_mixes_two() -> None:
    """Half of the scene slides aside: the mean motion explains no point, and that is no crash."""
    rng = np.random.default_rng(0)
    depth = rng.uniform(5.0, 8.0, (100, 1))
    p = np.concatenate([rng.uniform(-0.6, 0.6, (100, 2)), np.ones((100, 1))], axis=1) * depth
    q = p + np.where(np.arange(100)[:, None] < 50, [0.3, 0.0, 0.0], 0.0)
    before, now = project_stereo(p, T_CAM1_CAM0)[0], project_stereo(q, T_CAM1_CAM0)[0]
    assert solve_stereo_motion(before, now, T_CAM1_CAM0, np.eye(3), SIGMA, 0.05) is None


@pytest.mark.parametrize("seed", range(5))
def test_far_points_stay_with_the_world_though_a_near_body_has_all_near_ones(seed: int) -> None:
    """A vehicle beside the rig drives almost as fast. Within the gyroscope's error, most of the far
    street agrees with it as well: counted are more points than move with the world."""
    rng = np.random.default_rng(seed)
    n, n_body, sigma = 500, 120, np.full(4, 0.2 / 200.0)
    T_c1_c0 = se3.make(np.eye(3), np.array([-0.5, 0.0, 0.0]))
    depth = np.where(np.arange(n) < n_body, rng.uniform(4.5, 9.0, n), rng.uniform(12.0, 60.0, n))
    p = np.column_stack([rng.uniform(-0.7, 0.7, n), rng.uniform(-0.3, 0.3, n), np.ones(n)])
    p = p * depth[:, None]
    body, world = np.array([0.0, 0.0, -0.1]), np.array([0.0, 0.0, -0.8])
    q = p + np.where(np.arange(n)[:, None] < n_body, body, world)
    before, now = (
        project_stereo(x, T_c1_c0)[0] + rng.normal(0.0, 1.0, (n, 4)) * sigma for x in (p, q)
    )
    motion = solve_stereo_motion(before, now, T_c1_c0, np.eye(3), sigma, 0.005, max_motions=3)
    assert motion is not None
    np.testing.assert_allclose(motion.T_now_before[:3, 3], world, atol=0.08)
    assert motion.inlier[:n_body].mean() < 0.1
    assert motion.inlier[n_body:].mean() > 0.9
