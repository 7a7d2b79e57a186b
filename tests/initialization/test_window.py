"""The window of keyframes: its box-plus, the exposures' poses, and the filter's state."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.initialization.window import (
    KEYFRAME_SIZE,
    OFFSET,
    KeyframeWindow,
    exposure_poses,
    filter_state,
    window_plus,
)
from ovmot.settings import CalibrationSettings
from ovmot.vio.state import State, box_minus

Derivative = Callable[..., FloatArray]
MakeWindow = Callable[..., KeyframeWindow]


@pytest.fixture
def window(make_window: MakeWindow) -> KeyframeWindow:
    """Five keyframes, somewhat off, with a time offset and a deviating calibration."""
    window = make_window(5, CalibrationSettings(extrinsics=True))
    return window_plus(window, np.random.default_rng(1).normal(0.0, 0.02, window.size))


def test_box_plus_moves_each_coordinate_where_the_order_says(make_window: MakeWindow) -> None:
    window = make_window(3)
    error = np.random.default_rng(2).normal(0.0, 0.1, window.size)
    moved = window_plus(window, error)
    np.testing.assert_allclose(moved.gyro_bias, error[:3])
    np.testing.assert_allclose(moved.accel_bias, error[3:6])
    assert moved.offset_s == pytest.approx(error[OFFSET])
    for k in range(3):
        d = error[window.columns(k)]
        assert len(d) == KEYFRAME_SIZE
        R = window.T_world_imu[k, :3, :3].T @ moved.T_world_imu[k, :3, :3]
        np.testing.assert_allclose(so3.log(R), d[:3], atol=1e-12)
        step = moved.T_world_imu[k, :3, 3] - window.T_world_imu[k, :3, 3]
        np.testing.assert_allclose(step, d[3:6], atol=1e-12)
        np.testing.assert_allclose(moved.velocity[k] - window.velocity[k], d[6:])


def test_exposure_poses_are_differentiated_right(
    window: KeyframeWindow, central_differences: Derivative
) -> None:
    poses = exposure_poses(window)
    n = window.n_common

    def moved(error: FloatArray) -> FloatArray:
        T = exposure_poses(window_plus(window, error)).T_world_imu
        R = np.swapaxes(poses.T_world_imu[:, :3, :3], -1, -2) @ T[:, :3, :3]
        step = T[:, :3, 3] - poses.T_world_imu[:, :3, 3]
        return np.concatenate([so3.log(R), step], axis=1)

    J = central_differences(moved, np.zeros(window.size))
    np.testing.assert_allclose(J[..., :n], poses.by_common, atol=1e-7)
    for k in range(len(window)):
        np.testing.assert_allclose(J[k][:, window.columns(k)], poses.by_keyframe[k], atol=1e-7)


def test_a_later_exposure_lies_farther_on_the_path(make_window: MakeWindow) -> None:
    window = make_window(4)
    error = np.zeros(window.size)
    error[OFFSET] = 0.01
    later = exposure_poses(window_plus(window, error)).T_world_imu
    expected = window.T_world_imu[:, :3, 3] + 0.01 * window.velocity
    np.testing.assert_allclose(later[:, :3, 3], expected, atol=1e-12)
    turned = np.swapaxes(window.T_world_imu[:, :3, :3], -1, -2) @ later[:, :3, :3]
    np.testing.assert_allclose(so3.log(turned), 0.01 * window.gyro, atol=1e-9)


def test_the_filter_s_covariance_is_the_window_s(
    window: KeyframeWindow, central_differences: Derivative
) -> None:
    rng, kept = np.random.default_rng(3), np.array([1, 3, 4])
    A = rng.normal(size=(window.size, window.size))
    P = A @ A.T

    def state(at: KeyframeWindow) -> State:
        return filter_state(at, P, kept, at.imu_ns[kept], 0.002)

    here = state(window)
    G = central_differences(
        lambda e: box_minus(state(window_plus(window, e)), here), np.zeros(window.size)
    )
    expected = G @ P @ G.T
    scale = np.abs(expected).max()
    np.testing.assert_allclose(here.covariance, expected, atol=1e-6 * scale)
    assert here.timestamp_ns == window.imu_ns[-1]
    assert here.time_offset_s == 0.002 + window.offset_s
    np.testing.assert_array_equal(here.clones.timestamp_ns, window.imu_ns[kept])
