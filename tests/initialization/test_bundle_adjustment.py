"""Bundle adjustment: its normal equations, what it recovers, and the covariance it claims."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.bundle_adjustment import (
    AdjustedWindow,
    bundle_adjust,
    consider_covariance,
    keyframe_pixels,
    reproject_points,
    robustly_weighted,
    schur_complement,
)
from ovmot.initialization.factors import Factor, ImuIntervals, imu_factor, prior_factor
from ovmot.initialization.window import (
    BIAS_OF_ACCEL,
    BIAS_OF_GYRO,
    OFFSET,
    KeyframeWindow,
    exposure_clones,
    window_plus,
)
from ovmot.settings import CalibrationSettings, FilterSettings
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.integrators import integrate_rk4
from ovmot.vio.msckf_features import Reprojection, reproject
from ovmot.vio.online_calibration import calibrated_rig

G = 9.81
N = 9  # keyframes, 0.1 s apart
OFFSET_S = 0.002
OFFSET_SIGMA_S = 0.005
ACCEL_BIAS_SIGMA = 0.05
SETTINGS = FilterSettings()
Derivative = Callable[..., FloatArray]
MakeWindow = Callable[..., KeyframeWindow]


def seen_by(
    window: KeyframeWindow, rig: StereoRig, pixels: FloatArray, points: FloatArray
) -> Reprojection:
    clones = exposure_clones(window, window.imu_ns)
    now = calibrated_rig(rig, window.calibration)
    return reproject(clones, now, pixels, (points, points), 0.7, window.calibration)


def test_normal_equations_are_those_of_window_and_points_together(
    make_window: MakeWindow, rig: StereoRig, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], central_differences: Derivative,
) -> None:  # fmt: skip
    """Against finite differences by window and points, the points eliminated afterwards."""
    rng = np.random.default_rng(1)
    true = make_window(3, CalibrationSettings(extrinsics=True, intrinsics=True))
    frames = [observe(rig, T, landmarks, 0, 0.5, rng) for T in true.T_world_imu]
    ids = np.intersect1d(frames[0].feature_id, frames[-1].feature_id)[:6]
    pixels = keyframe_pixels(frames, ids)
    window = window_plus(true, rng.normal(0.0, 1e-3, true.size))
    points = landmarks[ids]
    n, k = window.size, 3 * len(points)

    def residual(error: FloatArray) -> FloatArray:
        moved = points + error[n:].reshape(-1, 3)
        return seen_by(window_plus(window, error[:n]), rig, pixels, moved).residual.ravel()

    # a residual is measured minus predicted: its derivative is minus that of the prediction
    J = -central_differences(residual, np.zeros(n + k))
    r = residual(np.zeros(n + k))
    A, b = J.T @ J, J.T @ r
    K = A[:n, n:] @ np.linalg.inv(A[n:, n:])
    information, gradient = schur_complement(window, seen_by(window, rig, pixels, points))
    scale = np.sqrt(np.diag(A)[:n].clip(1e-12))
    np.testing.assert_allclose(
        information / np.outer(scale, scale), (A[:n, :n] - K @ A[n:, :n]) / np.outer(scale, scale),
        atol=1e-5,
    )  # fmt: skip
    np.testing.assert_allclose(gradient / scale, (b[:n] - K @ b[n:]) / scale, atol=1e-4)


class Trial:
    """A noisy drive with biases and a time offset, the truth, and a guess that is off."""

    def __init__(
        self, seed: int, true: KeyframeWindow, path: PoseSpline, rig: StereoRig, noise: ImuNoise,
        landmarks: FloatArray, observe: Callable[..., FrontendFrame],
    ) -> None:  # fmt: skip
        rng = np.random.default_rng(seed)
        gyro_bias, accel_bias = rng.normal(0.0, 0.02, 3), rng.normal(0.0, ACCEL_BIAS_SIGMA, 3)
        delay_s = rng.normal(0.0, OFFSET_SIGMA_S)
        stamps = true.imu_ns[0] + 5_000_000 * np.arange(20 * (N - 1) + 1)
        steady = replace(noise, gyro_walk=1e-9, accel_walk=1e-9)
        data = noisy_imu(
            perfect_imu(path, stamps), steady, rng, gyro_bias=gyro_bias, accel_bias=accel_bias
        ).data
        cuts = [
            ImuData(data.timestamp_ns[a : b + 1], data.gyro[a : b + 1], data.accel[a : b + 1])
            for a, b in pairwise(range(0, len(data), 20))
        ]
        in_gap = [np.zeros(20, np.bool_) for _ in cuts]
        self.intervals = ImuIntervals(cuts, in_gap, steady, integrate_rk4)
        exposures = path.pose(true.imu_ns + round(1e9 * delay_s))
        frames = [observe(rig, T, landmarks, 0, SETTINGS.pixel_sigma, rng) for T in exposures]
        self.pixels = keyframe_pixels(frames, np.arange(len(landmarks)), max_features=150)
        self.true = replace(
            true, gyro=data.gyro[::20], gyro_bias=gyro_bias, accel_bias=accel_bias,
            offset_s=delay_s,
        )  # fmt: skip
        off = np.zeros(true.size)
        scale = np.repeat([2e-3, 1e-2, 0.2], 3)  # as of a closed-form solution
        off[true.n_common :] = (scale * rng.normal(size=(N, 9))).ravel()
        guess = window_plus(self.true, off)
        self.guess = replace(guess, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), offset_s=0.0)
        self.rig = rig

    def factors(self, at: KeyframeWindow) -> list[Factor]:
        return [
            imu_factor(at, self.intervals, G),
            prior_factor(at, ACCEL_BIAS_SIGMA, OFFSET_SIGMA_S, np.empty(0)),
        ]

    def adjusted(self) -> AdjustedWindow:
        return bundle_adjust(
            self.guess, self.factors, self.pixels, self.rig, SETTINGS, offset_is_free=True
        )

    def error(self, window: KeyframeWindow) -> FloatArray:
        """Error (N,) of a window whose world begins elsewhere and heads otherwise."""
        T, E = self.true.T_world_imu, window.T_world_imu
        D = E[0, :3, :3] @ T[0, :3, :3].T
        yaw = np.arctan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1])
        turn = so3.exp(np.array([0.0, 0.0, yaw]))
        R = so3.log(np.swapaxes(E[:, :3, :3], -1, -2) @ (turn @ T[:, :3, :3]))
        p = (T[:, :3, 3] - T[0, :3, 3]) @ turn.T + E[0, :3, 3] - E[:, :3, 3]
        v = self.true.velocity @ turn.T - window.velocity
        error = np.zeros(window.size)
        error[window.n_common :] = np.concatenate([R, p, v], axis=1).ravel()
        error[BIAS_OF_GYRO] = self.true.gyro_bias - window.gyro_bias
        error[BIAS_OF_ACCEL] = self.true.accel_bias - window.accel_bias
        error[OFFSET] = self.true.offset_s - window.offset_s
        return error


@pytest.fixture
def trial(
    make_window: MakeWindow, curvy_path: PoseSpline, rig: StereoRig, noise: ImuNoise,
    landmarks: FloatArray, observe: Callable[..., FrontendFrame],
) -> Callable[[int], Trial]:  # fmt: skip
    """From a seed."""
    return lambda seed: Trial(seed, make_window(N), curvy_path, rig, noise, landmarks, observe)


def test_recovers_poses_velocity_biases_and_offset(trial: Callable[[int], Trial]) -> None:
    drive = trial(1)
    before = drive.error(drive.guess)
    adjusted = drive.adjusted()
    error, sigma = drive.error(adjusted.window), np.sqrt(np.diag(adjusted.covariance))
    n = adjusted.window.n_common
    keyframes, was = error[n:].reshape(N, 9), before[n:].reshape(N, 9)
    assert np.abs(keyframes[:, :3]).max() < 0.004 < np.abs(was[:, :3]).max()
    assert np.linalg.norm(keyframes[:, 3:6]) < 0.8 * np.linalg.norm(was[:, 3:6])
    assert np.abs(keyframes[:, 3:6]).max() < 0.02
    assert np.abs(keyframes[:, 6:]).max() < 0.04 < np.abs(was[:, 6:]).max()
    assert np.abs(error[BIAS_OF_GYRO]).max() < 0.005
    assert np.abs(error[OFFSET]) < 0.001
    held = sigma > 1e-4  # not the world's place and heading
    assert (np.abs(error)[held] < 4.0 * sigma[held]).all()
    assert 0.3 < adjusted.factor_rms < 1.3  # what was fitted to the noise is gone
    assert 0.7 < adjusted.pixel_rms < 1.1


def test_points_are_recovered_with_the_poses(
    trial: Callable[[int], Trial], landmarks: FloatArray, rig: StereoRig
) -> None:
    drive = trial(2)
    window = drive.adjusted().window
    seen = reproject_points(window, drive.pixels, rig, SETTINGS)
    usual = np.median(
        (robustly_weighted(seen).residual ** 2).sum((1, 2)) / (seen.seen.sum((1, 2)) - 3)
    )
    assert 0.8 < usual < 1.2  # as far off as the pixels are noisy


def test_errors_are_as_large_as_claimed(trial: Callable[[int], Trial]) -> None:
    """NEES of the last keyframe's pose and velocity, of biases and time offset, over seeds."""
    n_trials, nees = 20, []
    for seed in range(n_trials):
        drive = trial(seed)
        adjusted = drive.adjusted()
        last = adjusted.window.columns(N - 1)
        chosen = np.r_[0 : OFFSET + 1, last.start : last.stop]
        e, P = drive.error(adjusted.window)[chosen], adjusted.covariance[np.ix_(chosen, chosen)]
        nees.append(e @ np.linalg.solve(P, e))
    dof = OFFSET + 1 + 9
    low, high = np.asarray(chi2.ppf([0.025, 0.975], dof * n_trials)) / n_trials
    assert low < np.mean(nees) < high


def test_a_body_among_the_points_is_weighed_down(trial: Callable[[int], Trial]) -> None:
    """A fifth of the points drifts off: the rest decides."""
    drive = trial(3)
    pixels = drive.pixels.copy()
    pixels[::5] += 3.0 * np.arange(N)[:, None] * np.array([1.0, 0.0, 1.0, 0.0])
    drive.pixels = pixels
    adjusted = drive.adjusted()
    error = drive.error(adjusted.window)[adjusted.window.n_common :].reshape(N, 9)
    assert np.abs(error[:, 3:6]).max() < 0.08
    assert np.abs(error[:, 6:]).max() < 0.15  # three times as much with even weights


def test_without_points_that_fit_it_refuses(trial: Callable[[int], Trial]) -> None:
    drive = trial(4)
    drive.pixels = drive.pixels[:5]
    with pytest.raises(InitializationError, match=r"\d of 5 points fit .*\(at least 8\)"):
        drive.adjusted()


def test_what_is_considered_is_in_the_covariance() -> None:
    """Least squares of x by J x + D c + n, c ignored: the errors are linear in c and n."""
    rng = np.random.default_rng(8)
    A = rng.normal(size=(30, 9))
    considered, variance = slice(4, 6), np.array([0.3, 2.0])
    free = np.ones(9, dtype=np.bool_)
    free[considered], free[8] = False, False
    found = consider_covariance(A.T @ A, free, considered, variance)
    by_noise = -np.linalg.pinv(A[:, free])  # of x - x_found
    by_considered = by_noise @ A[:, considered]
    expected = by_noise @ by_noise.T + (by_considered * variance) @ by_considered.T
    np.testing.assert_allclose(found[np.ix_(free, free)], expected, atol=1e-12)
    np.testing.assert_allclose(found[free, considered], by_considered * variance, atol=1e-12)
    np.testing.assert_array_equal(found[considered, considered], np.diag(variance))
    assert not found[8].any()
