"""The covariance of the static hypothesis, by drawing errors and by finite differences."""

from collections.abc import Callable

import numpy as np
import pytest
from static_twin import StaticComparison, compare_with_static

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.segmentation.stereo_history import history_of
from ovmot.types import PixelNoise, PoseWindow

SIGMA_PX = 0.4
NOISE = PixelNoise(SIGMA_PX, SIGMA_PX, 0.0, 0.0)
PERFECT = PixelNoise(0.0, 0.0, 0.0, 0.0)
Make = Callable[..., FloatArray]
Window = Callable[..., PoseWindow]


def perturbed(T_world_imu: FloatArray, delta: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) with errors (6K,): R exp(δθ), p + δp."""
    d = delta.reshape(-1, 6)
    return se3.make(T_world_imu[:, :3, :3] @ so3.exp(d[:, :3]), T_world_imu[:, :3, 3] + d[:, 3:])


def mahalanobis(comparison: StaticComparison) -> FloatArray:
    """Squared distances (L, N) of the residuals."""
    W = np.linalg.inv(comparison.S)
    r = comparison.residual
    return np.asarray(np.einsum("lni,lnij,lnj->ln", r, W, r))


def seen_from(
    rig: StereoRig, window: PoseWindow, normalized: FloatArray, noise: PixelNoise = NOISE
) -> StereoHistory:
    """All earlier frames of (K, N, 4) against the last, one a pose of the window."""
    k = len(normalized) - 1
    row = np.arange(k)
    return history_of(
        normalized[:-1], normalized[-1], np.arange(normalized.shape[1]), row,
        window.timestamp_ns[:-1], np.asarray(0.1 * (k - row), np.float64), k - row, rig, noise,
    )  # fmt: skip


def compared(
    rig: StereoRig, window: PoseWindow, normalized: FloatArray, noise: PixelNoise = NOISE
) -> StaticComparison:
    return compare_with_static(seen_from(rig, window, normalized, noise), window, rig)


@pytest.fixture
def pose_covariance() -> FloatArray:
    """Covariance (36, 36) of six poses, correlated: some 2 mrad and 2 cm."""
    A = np.random.default_rng(8).normal(size=(36, 36)) / 6.0
    A *= np.tile([2e-3] * 3 + [0.02] * 3, 6)[:, None]
    return A @ A.T


def test_exact_points_are_predicted_exactly(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    T, rng = drive(6), np.random.default_rng(0)
    p = in_view(rig, T, 30, (5.0, 40.0), rng)
    comparison = compared(rig, window_of(T), measure(rig, T, p, 0.0, rng))
    now = se3.apply(se3.inverse(T[-1] @ rig.T_imu_cam0), p)
    np.testing.assert_allclose(comparison.predicted, np.broadcast_to(now, (5, 30, 3)), atol=1e-8)
    assert np.abs(comparison.residual).max() < 1e-9
    assert comparison.tested.all()


def test_the_covariance_is_that_of_the_residuals(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window,
    pose_covariance: FloatArray,
) -> None:  # fmt: skip
    """Pixels and poses drawn 300 times: the squared distance has the mean 4 of chi-squared."""
    T, rng = drive(6), np.random.default_rng(1)
    drawn = []
    for _ in range(300):
        p = in_view(rig, T, 60, (5.0, 25.0), rng)
        m = measure(rig, T, p, SIGMA_PX, rng)
        T_estimated = perturbed(T, rng.multivariate_normal(np.zeros(36), pose_covariance))
        window = window_of(T_estimated, pose_covariance)
        drawn.append(mahalanobis(compared(rig, window, m)))
    per_row = np.mean(drawn, axis=(0, 2))
    np.testing.assert_allclose(per_row, 4.0, atol=0.4)  # poses are common to a draw's points
    without = [
        mahalanobis(
            compared(rig, window_of(T_estimated, 0.0 * pose_covariance), m)
        ).mean()
    ]  # fmt: skip
    assert without[0] > 6.0  # the poses' errors matter here


def test_pixels_alone_give_four_for_every_depth(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    T, rng = drive(6), np.random.default_rng(2)
    window = window_of(T, np.zeros((36, 36)))
    for depth in ((5.0, 8.0), (15.0, 20.0), (25.0, 30.0)):
        p = in_view(rig, T, 4000, depth, rng)
        comparison = compared(rig, window, measure(rig, T, p, SIGMA_PX, rng))
        np.testing.assert_allclose(mahalanobis(comparison).mean(1), 4.0, atol=0.25)


def test_the_ego_motion_s_part_by_finite_differences(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window,
    pose_covariance: FloatArray, central_differences: Callable[..., FloatArray],
) -> None:  # fmt: skip
    """With perfect pixels S = J (∂p/∂δ) P (∂p/∂δ)ᵀ Jᵀ over the errors of all six poses."""
    T, rng = drive(6), np.random.default_rng(3)
    p = in_view(rig, T, 7, (5.0, 30.0), rng)
    history = seen_from(rig, window_of(T), measure(rig, T, p, 0.0, rng), PERFECT)

    def predicted(delta: FloatArray) -> FloatArray:
        return compare_with_static(history, window_of(perturbed(T, delta)), rig).predicted

    D = central_differences(predicted, np.zeros(36), 1e-5)  # (5, 7, 3, 36)
    comparison = compare_with_static(history, window_of(T, pose_covariance), rig)
    JD = comparison.J @ D
    expected = JD @ pose_covariance @ np.swapaxes(JD, -1, -2)
    np.testing.assert_allclose(comparison.S, expected, rtol=1e-5, atol=1e-5 * expected.max())


def test_j_is_the_derivative_of_the_prediction(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    """A point that moves by d now leaves the residual J d, to first order."""
    T, rng = drive(3), np.random.default_rng(4)
    p = in_view(rig, T, 20, (8.0, 20.0), rng)
    R_cam_world = (T[-1] @ rig.T_imu_cam0)[:3, :3].T
    d_cam = np.array([1e-4, -2e-4, 3e-4])
    moved = np.stack([p, p, p + d_cam @ R_cam_world])
    comparison = compared(rig, window_of(T), measure(rig, T, moved, 0.0, rng))
    np.testing.assert_allclose(comparison.residual, comparison.J @ d_cam, rtol=2e-3, atol=1e-9)


def test_drift_widens_with_the_way_through_the_image(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    T, rng = drive(3), np.random.default_rng(5)
    p = in_view(rig, T, 10, (6.0, 20.0), rng)
    m = measure(rig, T, p, 0.0, rng)

    def S_of(per_frame_px: float, per_flow: float) -> FloatArray:
        return compared(
            rig, window_of(T), m, PixelNoise(SIGMA_PX, SIGMA_PX, per_frame_px, per_flow)
        ).S

    plain = S_of(0.0, 0.0)
    flow = np.linalg.norm(m[-1, :, :2] - m[:-1, :, :2], axis=-1)
    expected = (0.05 * flow[..., None, None]) ** 2 * np.eye(4)
    np.testing.assert_allclose(S_of(0.0, 0.05) - plain, expected, atol=1e-12)
    # a random walk: two frames back, twice the variance of one
    walk = np.array([2.0, 1.0])[:, None, None, None] * (0.3 / rig.cam0.fx) ** 2 * np.eye(4)
    np.testing.assert_allclose(
        S_of(0.3, 0.0) - plain, np.broadcast_to(walk, plain.shape), atol=1e-12
    )


def test_a_frame_that_shares_the_newest_pose_has_no_ego_error(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window,
    pose_covariance: FloatArray,
) -> None:  # fmt: skip
    T, rng = drive(6), np.random.default_rng(6)
    p = in_view(rig, T, 5, (6.0, 20.0), rng)
    m = measure(rig, T[[-1, -1]], p, 0.0, rng)
    newest_ns, one = window_of(T).timestamp_ns[-1:], np.array([1])
    shared = history_of(m[:1], m[1], np.arange(5), one, newest_ns, 0.1 * one, one, rig, NOISE)
    with_ego = compare_with_static(shared, window_of(T, pose_covariance), rig)
    without = compare_with_static(shared, window_of(T, 0.0 * pose_covariance), rig)
    np.testing.assert_allclose(with_ego.S, without.S, rtol=1e-9, atol=1e-15)


def test_what_was_not_seen_in_stereo_is_not_tested(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    T, rng = drive(4), np.random.default_rng(7)
    m = measure(rig, T, in_view(rig, T, 6, (5.0, 9.0), rng), SIGMA_PX, rng)
    m[0, 0, 2:] = np.nan  # mono then
    m[:, 1] = np.nan  # never
    m[-1, 2, 2:] = np.nan  # mono now
    comparison = compared(rig, window_of(T), m)
    assert comparison.tested[:, 0].tolist() == [False, True, True]
    assert not comparison.tested[:, 1:3].any()
    assert comparison.tested[:, 3:].all()


def test_a_point_that_the_camera_passed_is_not_tested(
    rig: StereoRig, drive: Make, measure: Make, window_of: Window
) -> None:
    T, rng = drive(2, speed=60.0), np.random.default_rng(7)  # 6 m between the frames
    p = se3.apply(T[0] @ rig.T_imu_cam0, np.array([[0.5, 0.0, 4.0], [0.5, 0.0, 40.0]]))
    m = measure(rig, T, p, 0.0, rng)
    comparison = compared(rig, window_of(T), m)
    assert comparison.tested[0].tolist() == [False, True]


def test_the_secant_reaches_any_distance_exactly(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Window
) -> None:
    """J is right for small steps only; a car that went from 8 to 20 m needs the secant."""
    T, rng = drive(2, speed=0.0), np.random.default_rng(9)
    p = in_view(rig, T, 20, (8.0, 20.0), rng)
    T_cam_world = se3.inverse(T[-1] @ rig.T_imu_cam0)
    step = rng.uniform(-4.0, 8.0, (20, 3)) * [1.0, 0.2, 0.2]
    m = measure(rig, T, np.stack([p, p + step]), 0.0, rng)
    comparison = compared(rig, window_of(T), m)
    step_cam = se3.apply(T_cam_world, p + step) - comparison.predicted[0]
    reached = (comparison.J_motion[0] @ step_cam[:, :, None])[..., 0]
    np.testing.assert_allclose(reached, comparison.residual[0], atol=1e-9)
    linear = (comparison.J[0] @ step_cam[:, :, None])[..., 0]
    assert np.abs(linear - comparison.residual[0]).max() > 5.0 / 408.0
