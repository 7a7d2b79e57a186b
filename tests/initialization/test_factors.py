"""Factors of the bundle adjustment: Jacobians, and residuals as large as they claim."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.factors import (
    GAUGE_SIGMA,
    Factor,
    ImuIntervals,
    imu_factor,
    prior_factor,
    zero_velocity_factor,
)
from ovmot.initialization.window import KeyframeWindow, window_plus
from ovmot.settings import CalibrationSettings
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import integrate_rk4

G = 9.81
N = 3
Derivative = Callable[..., FloatArray]
MakeWindow = Callable[..., KeyframeWindow]
CALIBRATIONS = {
    "none": CalibrationSettings(),
    "imu": CalibrationSettings(imu_intrinsics=True, g_sensitivity=True),
}


def cut(data: ImuData, noise: ImuNoise, samples_each: int) -> ImuIntervals:
    """The samples in intervals that share their ends."""
    ends = np.arange(0, len(data), samples_each)
    intervals = [
        ImuData(data.timestamp_ns[a : b + 1], data.gyro[a : b + 1], data.accel[a : b + 1])
        for a, b in pairwise(ends)
    ]
    return ImuIntervals(
        intervals, [np.zeros(len(p) - 1, np.bool_) for p in intervals], noise, integrate_rk4
    )


@pytest.fixture
def intervals(curvy_path: PoseSpline, noise: ImuNoise, start_ns: int) -> ImuIntervals:
    """Exact samples at 500 Hz of N - 1 tenths of a second."""
    stamps = start_ns + 2_000_000 * np.arange(50 * (N - 1) + 1)
    return cut(perfect_imu(curvy_path, stamps), noise, 50)


def assert_derivative(
    factor: Callable[[KeyframeWindow], Factor],
    window: KeyframeWindow,
    numeric: Derivative,
    rtol: float,
) -> None:
    """J against central differences of r, each row by its own scale."""
    J = factor(window)[1]
    expected = numeric(lambda e: factor(window_plus(window, e))[0], np.zeros(window.size))
    scale = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1.0)
    np.testing.assert_allclose(J / scale, expected / scale, atol=rtol)


@pytest.mark.parametrize("calibration", list(CALIBRATIONS))
def test_derivative_of_the_imu_factor(
    calibration: str,
    make_window: MakeWindow,
    intervals: ImuIntervals,
    central_differences: Derivative,
) -> None:
    window = make_window(N, CALIBRATIONS[calibration])
    rng = np.random.default_rng(1)
    off = window_plus(window, rng.normal(0.0, 0.003, window.size))
    # the transition is that of continuous time, and the weights are taken as constant
    assert_derivative(lambda at: imu_factor(at, intervals, G), off, central_differences, rtol=3e-3)


def test_derivative_of_the_zero_velocity_factor(
    make_window: MakeWindow, central_differences: Derivative
) -> None:
    assert_derivative(zero_velocity_factor, make_window(N), central_differences, 1e-6)


def test_derivative_of_the_prior_and_of_the_heading(
    make_window: MakeWindow, central_differences: Derivative
) -> None:
    window = make_window(N, CALIBRATIONS["imu"])
    window = window_plus(window, np.random.default_rng(2).normal(0.0, 0.1, window.size))
    variance = np.linspace(0.01, 0.02, len(window.calibration))
    r, J = prior_factor(window, 0.05, 0.003, variance)
    expected = central_differences(
        lambda e: prior_factor(window_plus(window, e), 0.05, 0.003, variance)[0],
        np.zeros(window.size),
    )
    others = np.arange(len(r)) != 3
    np.testing.assert_allclose(J[others], expected[others], rtol=1e-5, atol=1e-4)
    # the heading has no residual, but a turn about the vertical costs what it says, a tilt nothing
    R = window.T_world_imu[0, :3, :3]
    turns = R.T @ np.eye(3)  # about world's x, y and z
    cost = GAUGE_SIGMA * J[3, window.columns(0)][:3] @ turns
    np.testing.assert_allclose(cost, [0.0, 0.0, 1.0], atol=1e-12)
    assert r[3] == 0.0


def test_the_truth_has_no_residual(make_window: MakeWindow, intervals: ImuIntervals) -> None:
    r, _ = imu_factor(make_window(N), intervals, G)
    assert np.abs(r).max() < 0.01


def test_residuals_of_noisy_samples_are_white(
    make_window: MakeWindow, curvy_path: PoseSpline, noise: ImuNoise, start_ns: int
) -> None:
    window, rng, zero = make_window(N), np.random.default_rng(3), np.zeros(3)
    clean = perfect_imu(curvy_path, start_ns + 5_000_000 * np.arange(20 * (N - 1) + 1))
    white = ImuNoise(noise.gyro, 1e-9, noise.accel, 1e-9)
    total, n = 0.0, 0
    for _ in range(40):
        data = noisy_imu(clean, white, rng, gyro_bias=zero, accel_bias=zero).data
        r, _ = imu_factor(window, cut(data, white, 20), G)
        total, n = total + float(r @ r), n + len(r)
    # the mean of a pair's two samples has less noise than one: half at an interval's ends
    low, high = np.asarray(chi2.ppf([0.001, 0.999], n)) / n
    assert 0.95 * low < total / n < high
