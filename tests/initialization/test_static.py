"""Static initialization: is the rig stationary, by IMU and images; tilt and gyro bias."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.initialization.static import (
    StationaryPoints,
    check_images_are_stationary,
    check_imu_is_stationary,
    gravity_aligned_rotation,
    stationary_points,
    stationary_state,
)
from ovmot.settings import InitializationSettings
from ovmot.types import FrontendFrame, ImuData
from ovmot.vio.state import ImuState

G = 9.81
HALF_S = 500_000_000
SETTINGS = InitializationSettings()
MAX_PIXELS = 0.5
StartError = Callable[[ImuState, ImuState], FloatArray]


def stationary_imu(start_ns: int, R_world_imu: FloatArray, span_s: float = 0.5) -> ImuData:
    t = start_ns + 5_000_000 * np.arange(round(200 * span_s) + 1)
    one = np.ones((len(t), 1))
    return ImuData(t, one * np.zeros(3), one * (R_world_imu.T @ [0.0, 0.0, G]))


@pytest.mark.parametrize(
    "rotation", [[0.0, 0.0, 0.0], [0.3, -0.5, 2.0], [np.pi - 1e-9, 0.0, 0.0], [0.0, 1.5707, 0.0]]
)
def test_tilt_and_gyro_bias(rotation: list[float], start_ns: int, start_error: StartError) -> None:
    R, bias = so3.exp(np.array(rotation)), np.array([0.02, -0.03, 0.01])
    clean = stationary_imu(start_ns, R)
    imu = ImuData(clean.timestamp_ns, clean.gyro + bias, clean.accel)
    state = stationary_state(imu)
    error = start_error(ImuState(R, np.zeros(3), np.zeros(3), bias, np.zeros(3)), state)
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.R_world_imu.T[:, 2], R.T[:, 2], atol=1e-9)
    assert abs(np.arctan2(state.R_world_imu[1, 0], state.R_world_imu[0, 0])) < 1e-9


def why_imu_is_not_stationary(imu: ImuData) -> str:
    with pytest.raises(InitializationError) as error:
        check_imu_is_stationary(imu, SETTINGS, G)
    return str(error.value)


def is_stationary(points: StationaryPoints) -> bool:
    try:
        check_images_are_stationary(points, SETTINGS)
    except InitializationError:
        return False
    return True


def test_failures_name_the_reason_and_its_numbers(start_ns: int) -> None:
    rest = stationary_imu(start_ns, np.eye(3))
    wave = np.sin(np.arange(len(rest)))[:, None] * [0.0, 1.0, 0.0]
    check_imu_is_stationary(rest, SETTINGS, G)
    # biases are no motion
    biased = ImuData(rest.timestamp_ns, rest.gyro + 0.1, rest.accel)
    check_imu_is_stationary(biased, SETTINGS, G)
    turning = ImuData(rest.timestamp_ns, rest.gyro + 0.1 * wave, rest.accel)
    assert "gyroscope varies by 0.07" in why_imu_is_not_stationary(turning)
    shaking = ImuData(rest.timestamp_ns, rest.gyro, rest.accel + wave)
    assert "accelerometer varies by 0.7" in why_imu_is_not_stationary(shaking)
    for share in (0.0, 1.0 / 9.81):  # gravity removed, or in g
        light = ImuData(rest.timestamp_ns, rest.gyro, share * rest.accel)
        assert "(stationary within 1.5 of 9.81)" in why_imu_is_not_stationary(light)
    ids = np.arange(5)
    check_images_are_stationary(StationaryPoints(ids, 0.9, 50, 0), SETTINGS)
    with pytest.raises(InitializationError, match=r"only 10 % of the points .* \(at least 20 %\)"):
        check_images_are_stationary(StationaryPoints(ids, 0.1, 50, 0), SETTINGS)
    with pytest.raises(InitializationError, match=r"occupy 60 cells .* stationary ones 50"):
        check_images_are_stationary(StationaryPoints(ids, 0.9, 50, 60), SETTINGS)


def test_gravity_is_aligned_with_zero_yaw() -> None:
    for up in np.random.default_rng(3).normal(size=(20, 3)):
        R = gravity_aligned_rotation(up)
        np.testing.assert_allclose(R @ up / np.linalg.norm(up), [0.0, 0.0, 1.0], atol=1e-12)
        assert abs(np.arctan2(R[1, 0], R[0, 0])) < 1e-12


@pytest.mark.parametrize("rig_moves", [True, False])
def test_the_body_that_occupies_most_space_is_the_world(
    rig_moves: bool, rig: StereoRig, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], start_ns: int,
) -> None:  # fmt: skip
    """A truck has most of the points. Ahead at the rig's speed it keeps its place in the image;
    past a stationary rig it moves."""
    rng = np.random.default_rng(1)
    truck, street = rng.uniform([8.0, -1.2, -1.0], [10.0, 1.2, 2.0], (250, 3)), landmarks[:100]
    way = np.array([1.5, 0.0, 0.0])
    T = se3.make(np.eye(3), way if rig_moves else np.zeros(3))
    first = observe(rig, np.eye(4), np.concatenate([truck, street]), start_ns, 0.1, rng)
    last = observe(rig, T, np.concatenate([truck + way, street]), start_ns + HALF_S, 0.1, rng)
    points = stationary_points([first, last], rig, MAX_PIXELS)
    assert points.share > SETTINGS.rest_share
    assert is_stationary(points) != rig_moves


@pytest.mark.parametrize("way_m", [0.0, 0.05])
def test_a_creeping_rig_is_not_stationary(
    way_m: float, rig: StereoRig, landmarks: FloatArray, observe: Callable[..., FrontendFrame],
    start_ns: int,
) -> None:  # fmt: skip
    """Five centimetres: most points stay within half a pixel, but together they show it."""
    rng = np.random.default_rng(2)
    T = se3.make(np.eye(3), np.array([way_m, 0.0, 0.0]))
    first = observe(rig, np.eye(4), landmarks, start_ns, 0.1, rng)
    last = observe(rig, T, landmarks, start_ns + HALF_S, 0.1, rng)
    points = stationary_points([first, last], rig, MAX_PIXELS)
    assert points.share > 0.5
    assert is_stationary(points) == (way_m == 0.0)
