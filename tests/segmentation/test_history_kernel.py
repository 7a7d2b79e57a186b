"""The compiled comparison equals its plain NumPy twin; the ego motion's part is written out."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.segmentation.history_kernel import (
    distance_from_static,
    distance_from_static_compiled,
    fit_velocities,
    fit_velocities_compiled,
    triangulate_pairs,
    triangulate_pairs_compiled,
    weigh,
    weigh_compiled,
)
from ovmot.segmentation.static_comparison import StaticComparison, compare_with_static
from ovmot.segmentation.stereo_history import history_of
from ovmot.types import PixelNoise, PoseWindow

SIGMA_PX = 0.3
NOISE = PixelNoise(SIGMA_PX, 0.2, 0.02)
ROWS = np.array([0, 2, 5])
Case = tuple[StereoHistory, PoseWindow, StaticComparison]


@pytest.fixture
def case(
    rig: StereoRig, drive: Callable[..., FloatArray], measure: Callable[..., FloatArray],
    window_of: Callable[..., PoseWindow],
) -> Case:  # fmt: skip
    """30 points, every second of them moving, some unseen or impossible."""
    rng = np.random.default_rng(8)
    T = drive(8)
    p = rng.uniform([-4.0, -2.0, 8.0], [4.0, 2.0, 40.0], (30, 3))
    moves = np.where(np.arange(30) % 2, 0.3, 0.0)[None, :, None] * np.arange(8.0)[:, None, None]
    p_world = se3.apply(T[-1] @ rig.T_imu_cam0, p) + moves * [1.0, 0.2, 0.0]
    m = measure(rig, T, p_world, SIGMA_PX, rng)
    m[0, 3, 2:] = np.nan
    m[2, 4, 2] = m[2, 4, 0] + 0.5  # behind the camera
    m[-1, 5] = np.nan
    L = 0.01 * rng.normal(0.0, 1.0, (48, 48))
    window = window_of(T, L @ L.T)
    history = history_of(
        m[ROWS], m[-1], np.arange(30), ROWS, window.timestamp_ns[ROWS], 0.1 * (7.0 - ROWS),
        7 - ROWS, rig, NOISE,
    )  # fmt: skip
    return history, window, compare_with_static(history, window, rig)


def ego_covariance(history: StereoHistory, window: PoseWindow, rig: StereoRig) -> FloatArray:
    """What two poses' errors, rotation on the right and position, do to the predicted points."""
    T_now, T_then = window.T_world_imu[-1], window.T_world_imu[history.row]
    p_then = se3.apply(rig.T_imu_cam0, triangulate_stereo(history.then, rig.T_cam1_cam0))
    p_now = se3.apply((se3.inverse(T_now) @ T_then)[:, None], p_then)
    R_now_T = T_now[:3, :3].T
    J = np.empty((*p_then.shape, 12))
    J[..., 0:3], J[..., 3:6], J[..., 9:12] = so3.hat(p_now), -R_now_T, R_now_T
    J[..., 6:9] = -(R_now_T @ T_then[:, None, :3, :3]) @ so3.hat(p_then)
    J = rig.T_imu_cam0[:3, :3].T @ J
    index = [np.r_[42:48, 6 * k : 6 * k + 6] for k in history.row]
    P = np.stack([window.covariance[np.ix_(i, i)] for i in index])
    return np.asarray(J @ P[:, None] @ np.swapaxes(J, -1, -2))


def test_the_comparison_equals_its_twin(rig: StereoRig, case: Case) -> None:
    history, window, found = case
    sigma, T10 = rig.normalized_sigma(SIGMA_PX), rig.T_cam1_cam0
    p_then = triangulate_stereo(history.then, T10)
    T = window.T_world_imu @ rig.T_imu_cam0
    T_now_then = (se3.inverse(T[-1]) @ T[history.row])[:, None]
    p_now = triangulate_stereo(history.now, T10)
    there = np.isfinite(p_now[None, :, :1])
    predicted = np.where(there, se3.apply(T_now_then, p_then), np.nan)
    R = T_now_then[..., :3, :3]
    C = R @ stereo_covariance(p_then, T10, sigma) @ np.swapaxes(R, -1, -2)
    C = C + ego_covariance(history, window, rig)
    flow = np.linalg.norm((history.now - history.then)[..., :2], axis=-1)
    by_frame = NOISE.drift_per_frame_px**2 * (7.0 - ROWS) / rig.cam0.fx**2
    drifted = by_frame[:, None] + (NOISE.drift_per_flow * flow) ** 2
    noise = np.diag(sigma**2) + drifted[..., None, None] * np.eye(4)
    h, J = project_stereo(predicted, T10)
    J_now = project_stereo(p_now, T10)[1]
    S = J @ C @ np.swapaxes(J, -1, -2) + noise
    S_motion = J_now @ C @ np.swapaxes(J_now, -1, -2) + noise
    np.testing.assert_array_equal(found.tested, np.isfinite(h).all(-1))
    assert 80 < found.tested.sum() < 90
    off = history.now - h
    for name, twin in (
        ("predicted", predicted), ("residual", off), ("J", J), ("S", S), ("S_motion", S_motion),
    ):  # fmt: skip
        actual = getattr(found, name)[found.tested]
        scale = np.abs(twin[found.tested]).max()
        np.testing.assert_allclose(actual, twin[found.tested], rtol=1e-8, atol=1e-10 * scale)
    way = (p_now - predicted)[..., None]
    seen = project_stereo(p_now, T10)[0]  # the right point, put onto its epipolar line
    np.testing.assert_allclose((found.J_motion @ way)[..., 0], seen - h, atol=1e-12)


@pytest.mark.parametrize("fit", [fit_velocities, fit_velocities_compiled])
def test_velocities_are_those_of_weighted_least_squares(
    case: Case, fit: Callable[..., tuple[FloatArray, ...]]
) -> None:
    c, slack = case[2], np.array([0.2, 0.1, 0.05])
    t = c.tested
    velocity, covariance, cost = fit(
        c.residual, c.J_motion, c.S_motion, c.J, slack, c.span_s, c.tested
    )
    for n in np.flatnonzero(t.any(0)):
        N, g, rows = 1e-6 * np.eye(3), np.zeros(3), np.flatnonzero(t[:, n])
        W = [np.linalg.inv(c.S_motion[k, n] + slack[k] * c.J[k, n] @ c.J[k, n].T) for k in rows]
        for w, k in zip(W, rows, strict=True):
            J = c.J_motion[k, n] * c.span_s[k]
            N, g = N + J.T @ w @ J, g + J.T @ w @ c.residual[k, n]
        v = np.linalg.solve(N, g)
        left = [c.residual[k, n] - c.J_motion[k, n] @ v * c.span_s[k] for k in rows]
        np.testing.assert_allclose(velocity[n], v, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(covariance[n], np.linalg.inv(N), rtol=1e-5, atol=1e-9)
        total = sum(r @ w @ r for r, w in zip(left, W, strict=True))
        np.testing.assert_allclose(cost[n], total, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("weights", [weigh, weigh_compiled])
def test_weights_are_inverse_covariances(
    case: Case, weights: Callable[..., tuple[FloatArray, FloatArray]]
) -> None:
    c = case[2]
    weight, information = weights(c.J_motion, c.S_motion, c.tested)
    W, J = np.linalg.inv(c.S_motion[c.tested]), c.J_motion[c.tested]
    np.testing.assert_allclose(weight[c.tested], W, rtol=1e-7, atol=1e-9 * W.max())
    expected = np.swapaxes(J, -1, -2) @ W @ J
    np.testing.assert_allclose(information[c.tested], expected, rtol=1e-6, atol=1e-6)
    assert not weight[~c.tested].any() and not information[~c.tested].any()


@pytest.mark.parametrize("distance", [distance_from_static, distance_from_static_compiled])
def test_the_quick_distance_is_that_of_the_oldest_row(
    rig: StereoRig, case: Case, distance: Callable[..., FloatArray]
) -> None:
    history, window, _ = case
    sigma, T10 = rig.normalized_sigma(SIGMA_PX), rig.T_cam1_cam0
    T = window.T_world_imu @ rig.T_imu_cam0
    T_now_then = se3.inverse(T[-1]) @ T[history.row]
    p_now = triangulate_stereo(history.now, T10)
    predicted = se3.apply(T_now_then[:, None], triangulate_stereo(history.then, T10))
    variance = 2.0 * np.diagonal(stereo_covariance(p_now, T10, sigma), axis1=1, axis2=2)
    squared = ((predicted - p_now) ** 2 / variance).sum(-1)
    oldest = np.where(np.isfinite(squared[0]), squared[0], squared[1])
    found = distance(history.p_then, history.p_now, history.cov_now, T_now_then)
    np.testing.assert_allclose(found, np.nan_to_num(oldest), rtol=1e-8)
    assert found[3] > 0.0 and found[5] == 0.0


@pytest.mark.parametrize("pairs", [triangulate_pairs, triangulate_pairs_compiled])
def test_pairs_are_triangulated_as_by_the_twin(
    rig: StereoRig, case: Case, pairs: Callable[..., tuple[FloatArray, FloatArray]]
) -> None:
    uv, T10 = case[0].now, np.ascontiguousarray(rig.T_cam1_cam0)
    sigma = rig.normalized_sigma(SIGMA_PX)
    p, C = pairs(uv, T10, sigma)
    twin = triangulate_stereo(uv, T10)
    np.testing.assert_allclose(p, twin, rtol=1e-12)
    np.testing.assert_allclose(C, stereo_covariance(twin, T10, sigma), rtol=1e-9, atol=1e-15)
    assert np.isnan(p[5]).all() and np.isfinite(p[0]).all()
