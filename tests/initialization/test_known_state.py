"""Initialization by a known state: the given state at the given frame, with the given sigmas."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.initialization.known_state import InitialSigmas, KnownStateInitializer
from ovmot.settings import Settings
from ovmot.types import FrontendFrame, ImuNoise
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import N_IMU, TIME_OFFSET, State


@pytest.fixture
def state(make_state: Callable[..., State]) -> State:
    return make_state(np.random.default_rng(3), 0)


@pytest.fixture
def start(state: State, rig: StereoRig, noise: ImuNoise, start_ns: int) -> KnownStateInitializer:
    sigmas = InitialSigmas(rotation=0.1, position=0.2, velocity=0.3, gyro_bias=0.4, accel_bias=0.5)
    return KnownStateInitializer(start_ns, state.imu, sigmas, rig, noise, Settings())


def frame_at(stamp: int) -> FrontendFrame:
    none, ints = np.empty((0, 4)), np.empty(0, dtype=np.int64)
    return FrontendFrame(stamp, ints, none, none, ints, np.empty(0, np.bool_))


def test_the_filter_starts_at_the_known_state(
    start: KnownStateInitializer, state: State, start_ns: int
) -> None:
    started = start((frame_at(start_ns),), ImuBuffer())
    assert not isinstance(started, str)
    ego, table = started
    assert table.shape == (0, 0)
    assert ego.state.timestamp_ns == start_ns
    assert ego.state.imu is state.imu
    sigma = np.sqrt(np.diag(ego.state.covariance))
    np.testing.assert_allclose(sigma[:N_IMU], np.repeat([0.1, 0.2, 0.3, 0.4, 0.5], 3))
    assert sigma[TIME_OFFSET] == Settings().filter.time_offset_sigma_s


def test_another_frame_is_no_start(start: KnownStateInitializer, start_ns: int) -> None:
    why = start((frame_at(start_ns + 1),), ImuBuffer())
    assert isinstance(why, str)
    assert str(start_ns + 1) in why
