"""Initialization with one camera: gyroscope bias, closed form, scale, or why there is none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drive_fixtures import ACCEL_BIAS_TRUE, FRAME_NS, GYRO_BIAS_TRUE, intervals_of

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.dynamic import InitializationPrior
from ovmot.initialization.initializer import FilterInitializer
from ovmot.initialization.monocular import gyro_bias_of_rays, monocular_initialization
from ovmot.initialization.window import KeyframeWindow, scale_sigma
from ovmot.settings import Settings
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.online_calibration import OnlineCalibration

N_FRAMES = 21
"""Of a window of 2 s at 10 frames a second."""
PRIOR = InitializationPrior(9.81, 0.05)
Observe = Callable[..., FrontendFrame]
MONO = Settings.model_validate({"tracker": {"cameras": "left"}})


def left_only(frame: FrontendFrame) -> FrontendFrame:
    pixels, normalized = frame.pixels.copy(), frame.normalized.copy()
    pixels[:, 2:] = normalized[:, 2:] = np.nan
    return replace(frame, pixels=pixels, normalized=normalized)


@pytest.fixture
def stamps(start_ns: int) -> list[int]:
    return [start_ns + FRAME_NS * k for k in range(N_FRAMES)]


@pytest.fixture
def clean_imu(curvy_path: PoseSpline, start_ns: int) -> ImuData:
    return perfect_imu(curvy_path, start_ns - 600_000_000 + 5_000_000 * np.arange(550))


def buffer_of(data: ImuData) -> ImuBuffer:
    buffer = ImuBuffer()
    for stamp, gyro, accel in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    return buffer


def test_exact_data_give_the_exact_state(
    rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray, observe: Observe,
    noise: ImuNoise, stamps: list[int], clean_imu: ImuData,
) -> None:  # fmt: skip
    frames = [left_only(observe(rig, curvy_path.pose(t), landmarks, t)) for t in stamps]
    found = monocular_initialization(frames, intervals_of(clean_imu, stamps), rig, noise, PRIOR)
    T = curvy_path.pose(stamps[0])
    v_body = T[:3, :3].T @ curvy_path.velocity(stamps[0])
    np.testing.assert_allclose(found.first.R_world_imu.T @ found.first.velocity, v_body, atol=0.01)
    up = found.first.R_world_imu.T @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, T[:3, :3].T @ [0.0, 0.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(found.first.gyro_bias, 0.0, atol=1e-4)
    path, true = (
        np.linalg.inv(X[0]) @ X for X in (found.T_world_imu, curvy_path.pose(np.array(stamps)))
    )
    np.testing.assert_allclose(path, true, atol=0.02)
    assert len(found.feature_id) > 100


def test_gyroscope_bias_by_rays_alone(
    rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray, observe: Observe,
    noise: ImuNoise, stamps: list[int], clean_imu: ImuData,
) -> None:  # fmt: skip
    """Also where a fifth of the points move on their own."""
    rng, sigma = np.random.default_rng(3), 0.5 / rig.cam0.fx
    biased = replace(clean_imu, gyro=clean_imu.gyro + GYRO_BIAS_TRUE)
    movers = (np.arange(len(landmarks)) % 5 == 0)[:, None]
    rays = np.full((N_FRAMES, len(landmarks), 3), np.nan)
    for k, t in enumerate(stamps):
        points = landmarks + movers * [0.0, 0.15 * k, 0.0]
        seen = observe(rig, curvy_path.pose(t), points, t, 0.5, rng)
        homogeneous = np.column_stack([seen.normalized[:, :2], np.ones(len(seen))])
        rays[k, seen.feature_id] = homogeneous / np.linalg.norm(homogeneous, axis=1)[:, None]
    R = rig.T_imu_cam0[:3, :3]
    found = gyro_bias_of_rays(rays, intervals_of(biased, stamps), R, noise, sigma)
    np.testing.assert_allclose(found, GYRO_BIAS_TRUE, atol=3e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_moving_rig_with_one_camera_is_initialized(
    seed: int, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray, observe: Observe,
    noise: ImuNoise, stamps: list[int], clean_imu: ImuData,
) -> None:  # fmt: skip
    rng, noise = np.random.default_rng(seed), replace(noise, accel=3e-3, accel_walk=3e-4)
    data = noisy_imu(
        clean_imu, noise, rng, gyro_bias=GYRO_BIAS_TRUE, accel_bias=ACCEL_BIAS_TRUE
    ).data
    mono = StereoRig.monocular(rig.cam0, rig.T_imu_cam0)
    initializer = FilterInitializer(mono, noise, Settings())
    frames = [left_only(observe(rig, curvy_path.pose(t), landmarks, t, 0.5, rng)) for t in stamps]
    too_short = initializer(frames[:13], buffer_of(data))
    assert "dynamic initialization: 1.20 s of frames (needs 2 s)" in too_short
    found = initializer(frames, buffer_of(data))
    assert not isinstance(found, str), found
    state = found[0].state
    T, true = state.clones.T_world_imu, curvy_path.pose(state.clones.timestamp_ns)
    between, expected = se3.inverse(T[0]) @ T, se3.inverse(true[0]) @ true
    length = float(np.linalg.norm(expected[-1, :3, 3]))
    assert np.linalg.norm(between[-1, :3, 3]) == pytest.approx(length, rel=0.05)
    np.testing.assert_allclose(state.imu.gyro_bias, GYRO_BIAS_TRUE, atol=2e-3)
    # a scale that is not known well enough is waited for
    exacting = Settings.model_validate({"initialization": {"mono_scale_sigma": 1e-4}})
    waits = FilterInitializer(mono, noise, exacting)(frames, buffer_of(data))
    assert "one camera, and too little acceleration: the scale is known to" in waits
    # the setting for one camera of two does the same
    other = FilterInitializer(rig, noise, MONO)(frames, buffer_of(data))
    assert not isinstance(other, str)
    np.testing.assert_array_equal(other[0].state.clones.T_world_imu, T)


def test_without_acceleration_the_scale_is_not_known(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, noise: ImuNoise, stamps: list[int],
    clean_imu: ImuData,
) -> None:  # fmt: skip
    rng, one = np.random.default_rng(1), np.ones((len(clean_imu.timestamp_ns), 1))
    straight = ImuData(clean_imu.timestamp_ns, one * np.zeros(3), one * [0.0, 0.0, 9.81])
    data = noisy_imu(straight, noise, rng, gyro_bias=GYRO_BIAS_TRUE, accel_bias=ACCEL_BIAS_TRUE)
    frames = []
    for k, t in enumerate(stamps):
        T = se3.make(np.eye(3), np.array([0.3 * k, 0.0, 0.0]))
        frames.append(left_only(observe(rig, T, landmarks, t, 0.5, rng)))
    reason = FilterInitializer(rig, noise, MONO)(frames, buffer_of(data.data))
    assert isinstance(reason, str)
    assert "one camera needs accelerations to know the scale" in reason
    with pytest.raises(InitializationError, match="points tracked over the window"):
        few = [left_only(observe(rig, np.eye(4), landmarks[:3], t)) for t in stamps]
        monocular_initialization(few, intervals_of(straight, stamps), rig, noise, PRIOR)


def test_a_rig_at_rest_with_one_camera_is_initialized(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, noise: ImuNoise, stamps: list[int],
    clean_imu: ImuData,
) -> None:  # fmt: skip
    rng, one = np.random.default_rng(1), np.ones((len(clean_imu.timestamp_ns), 1))
    R = so3.exp(np.array([0.1, -0.2, 0.0]))
    rest = ImuData(clean_imu.timestamp_ns, one * np.zeros(3), one * (R.T @ [0.0, 0.0, 9.81]))
    quiet = replace(noise, accel=5e-3)
    data = noisy_imu(rest, quiet, rng, gyro_bias=GYRO_BIAS_TRUE, accel_bias=np.zeros(3)).data
    T, mono = se3.make(R, np.zeros(3)), StereoRig.monocular(rig.cam0, rig.T_imu_cam0)
    initializer = FilterInitializer(mono, quiet, Settings())

    def frames(share: float) -> list[FrontendFrame]:
        movers = (np.arange(len(landmarks)) < share * len(landmarks))[:, None]
        return [
            left_only(observe(rig, T, landmarks + movers * [0.0, 0.3 * k, 0.0], t, 0.1, rng))
            for k, t in enumerate(stamps[:6])
        ]

    found = initializer(frames(0.2), buffer_of(data))
    assert not isinstance(found, str), found
    assert found[0].stationary
    np.testing.assert_allclose(found[0].state.imu.gyro_bias, GYRO_BIAS_TRUE, atol=4e-3)
    # a world that passes by, but for what is far away, is no rest
    assert "% of the points are stationary (at least 50 %)" in initializer(
        frames(0.6), buffer_of(data)
    )


def test_scale_sigma_is_that_of_a_least_squares_fit() -> None:
    zero = np.zeros(3)
    T = se3.make(np.eye(3), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    window = KeyframeWindow(
        np.arange(3), T, np.zeros((3, 3)), np.zeros((3, 3)), zero, zero, 0.0, OnlineCalibration()
    )
    covariance = np.zeros((window.size, window.size))
    for k in (1, 2):
        columns = window.columns(k)
        covariance[columns, columns][3:6, 3:6] = 0.01**2 * np.eye(3)
    assert scale_sigma(window, covariance) == pytest.approx(0.01 / np.sqrt(5.0))
    assert (
        scale_sigma(replace(window, T_world_imu=np.tile(np.eye(4), (3, 1, 1))), covariance)
        == np.inf
    )
