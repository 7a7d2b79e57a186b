"""Start at rest: is it one, by IMU and picture; level and gyro bias."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.initialization.static import (
    StandingPoints,
    image_restless,
    imu_restless,
    standing_points,
    static_initialization,
)
from ovmot.settings import InitializationSettings
from ovmot.types import FrontendFrame, ImuData
from ovmot.vio.state import ImuState

G = 9.81
SETTINGS = InitializationSettings()
StartError = Callable[[ImuState, ImuState], FloatArray]


def resting_imu(start_ns: int, R_world_imu: FloatArray, span_s: float = 0.5) -> ImuData:
    t = start_ns + 5_000_000 * np.arange(round(200 * span_s) + 1)
    one = np.ones((len(t), 1))
    return ImuData(t, one * np.zeros(3), one * (R_world_imu.T @ [0.0, 0.0, G]))


@pytest.mark.parametrize(
    "rotation", [[0.0, 0.0, 0.0], [0.3, -0.5, 2.0], [np.pi - 1e-9, 0.0, 0.0], [0.0, 1.5707, 0.0]]
)
def test_levels_and_takes_the_gyro_bias(
    rotation: list[float], start_ns: int, start_error: StartError
) -> None:
    R, bias = so3.exp(np.array(rotation)), np.array([0.02, -0.03, 0.01])
    clean = resting_imu(start_ns, R)
    imu = ImuData(clean.timestamp_ns, clean.gyro + bias, clean.accel)
    state = static_initialization(imu)
    error = start_error(ImuState(R, np.zeros(3), np.zeros(3), bias, np.zeros(3)), state)
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.R_world_imu.T[:, 2], R.T[:, 2], atol=1e-9)
    assert abs(np.arctan2(state.R_world_imu[1, 0], state.R_world_imu[0, 0])) < 1e-9


def test_failures_name_the_reason_and_its_numbers(start_ns: int) -> None:
    rest = resting_imu(start_ns, np.eye(3))
    wave = np.sin(np.arange(len(rest)))[:, None] * [0.0, 1.0, 0.0]
    assert imu_restless(rest, SETTINGS, G) is None
    # biases are no motion
    assert (
        imu_restless(ImuData(rest.timestamp_ns, rest.gyro + 0.1, rest.accel), SETTINGS, G) is None
    )
    turning = ImuData(rest.timestamp_ns, rest.gyro + 0.1 * wave, rest.accel)
    assert "gyroscope varies by 0.07" in str(imu_restless(turning, SETTINGS, G))
    shaking = ImuData(rest.timestamp_ns, rest.gyro, rest.accel + wave)
    assert "accelerometer varies by 0.7" in str(imu_restless(shaking, SETTINGS, G))
    for share in (0.0, 1.0 / 9.81):  # gravity taken off, or in g
        light = ImuData(rest.timestamp_ns, rest.gyro, share * rest.accel)
        assert "(at rest within 1.5 of 9.81)" in str(imu_restless(light, SETTINGS, G))
    ids = np.arange(5)
    assert image_restless(StandingPoints(ids, 0.9, 50, 0), SETTINGS) is None
    few = image_restless(StandingPoints(ids, 0.1, 50, 0), SETTINGS)
    assert "only 10 % of the points stand still (at rest at least 20 %)" in str(few)
    small = image_restless(StandingPoints(ids, 0.9, 50, 60), SETTINGS)
    assert "moves together fills 60 cells of space, what stands still 50" in str(small)


@pytest.mark.parametrize("rig_moves", [True, False])
def test_what_fills_most_room_tells_whether_the_rig_rests(
    rig_moves: bool, rig: StereoRig, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], start_ns: int,
) -> None:  # fmt: skip
    """A truck has most of the points. Ahead at our speed it keeps its place in the picture; past a
    resting rig it moves."""
    rng = np.random.default_rng(1)
    truck, street = rng.uniform([8.0, -1.2, -1.0], [10.0, 1.2, 2.0], (250, 3)), landmarks[:100]
    way = np.array([1.5, 0.0, 0.0])
    T = se3.make(np.eye(3), way if rig_moves else np.zeros(3))
    first = observe(rig, np.eye(4), np.concatenate([truck, street]), start_ns, 0.1, rng)
    last = observe(rig, T, np.concatenate([truck + way, street]), start_ns, 0.1, rng)
    points = standing_points(first, last, rig, SETTINGS.rest_pixel)
    assert points.share > SETTINGS.rest_share
    assert (image_restless(points, SETTINGS) is not None) == rig_moves


@pytest.mark.parametrize("way_m", [0.0, 0.05])
def test_a_creep_is_no_rest(
    way_m: float, rig: StereoRig, landmarks: FloatArray, observe: Callable[..., FrontendFrame],
    start_ns: int,
) -> None:  # fmt: skip
    """Five centimetres: most points stay within half a pixel, but together they show it."""
    rng = np.random.default_rng(2)
    T = se3.make(np.eye(3), np.array([way_m, 0.0, 0.0]))
    first = observe(rig, np.eye(4), landmarks, start_ns, 0.1, rng)
    last = observe(rig, T, landmarks, start_ns, 0.1, rng)
    points = standing_points(first, last, rig, SETTINGS.rest_pixel)
    assert points.share > 0.5
    assert (image_restless(points, SETTINGS) is not None) == (way_m > 0.0)
