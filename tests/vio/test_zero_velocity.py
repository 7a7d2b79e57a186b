"""Zero velocity: detected while others move, refused while creeping, and held for a minute."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from histories import newest_history

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_dynamic, mark_outliers
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.initialization.known_state import InitialSigmas, KnownStateInitializer
from ovmot.settings import Settings, ZeroVelocitySettings
from ovmot.sim.imu import noisy_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import VELOCITY, Clones, ImuState, State, box_plus, marginalize_clone
from ovmot.vio.zero_velocity import (
    image_is_stationary,
    prediction_is_stationary,
    stationary_share,
    zero_velocity_measurement,
    zero_velocity_update,
)

SETTINGS = ZeroVelocitySettings()
Derivative = Callable[..., FloatArray]
Observe = Callable[..., FrontendFrame]


@pytest.fixture
def resting(make_state: Callable[..., State]) -> State:
    """Two clones at the same place, velocity zero, everything known to a driving filter's sigma."""
    state = make_state(np.random.default_rng(1), 2)
    T = np.repeat(state.clones.T_world_imu[:1], 2, axis=0)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    P[VELOCITY, VELOCITY] = 0.02**2 * np.eye(3)
    # clones of one filter share their errors: their difference is known far better than they are
    a, b = state.clone_columns(0), state.clone_columns(1)
    P[a, a] = P[b, b] = P[a, b] = P[b, a] = 1e-2 * np.eye(6)
    P[b, b] += 1e-6 * np.eye(6)
    return replace(
        state,
        imu=replace(state.imu, velocity=np.zeros(3)),
        clones=Clones(state.clones.timestamp_ns, T, T),
        covariance=P,
    )


def test_measurement_is_the_derivative_of_its_residual(
    make_state: Callable[..., State], central_differences: Derivative
) -> None:
    state = make_state(np.random.default_rng(2), 3)
    H, columns, residual, variance = zero_velocity_measurement(state)
    n = len(state.covariance)
    H_full = np.zeros((len(residual), n))
    H_full[:, columns] = H
    expected = -central_differences(
        lambda e: zero_velocity_measurement(box_plus(state, e))[2], np.zeros(n)
    )
    np.testing.assert_allclose(H_full, expected, atol=1e-7)
    assert (variance > 0.0).all()


@pytest.mark.parametrize("direction", [0, 1, 2])
def test_creeping_behind_cars_that_look_stationary_is_no_zero_velocity(
    resting: State, direction: int
) -> None:
    velocity = np.zeros(3)
    velocity[direction] = 0.3
    T = resting.clones.T_world_imu.copy()
    T[1, :3, 3] += 0.1 * velocity
    creeping = replace(
        resting,
        imu=replace(resting.imu, velocity=velocity),
        clones=replace(resting.clones, T_world_imu=T),
    )
    assert not prediction_is_stationary(creeping)


def test_turning_on_the_spot_is_no_zero_velocity(resting: State) -> None:
    T = resting.clones.T_world_imu.copy()
    T[1, :3, :3] = T[1, :3, :3] @ so3.exp(np.array([0.0, 0.0, 0.02]))
    turning = replace(resting, clones=replace(resting.clones, T_world_imu=T))
    assert not prediction_is_stationary(turning)


def test_the_prediction_needs_two_clones(resting: State) -> None:
    assert prediction_is_stationary(resting)
    assert not prediction_is_stationary(marginalize_clone(resting, 0))


def test_update_removes_velocity_and_motion(resting: State) -> None:
    T = resting.clones.T_world_imu.copy()
    T[1, :3, 3] += [0.004, -0.003, 0.002]
    T[1, :3, :3] = T[1, :3, :3] @ so3.exp(np.array([1e-3, -5e-4, 8e-4]))
    moved = replace(
        resting,
        imu=replace(resting.imu, velocity=np.array([0.02, 0.01, -0.02])),
        clones=replace(resting.clones, T_world_imu=T),
        covariance=resting.covariance + 1e-3 * np.eye(len(resting.covariance)),
    )
    updated = zero_velocity_update(moved)
    before, after = (
        zero_velocity_measurement(moved)[2],
        zero_velocity_measurement(updated)[2],
    )
    assert np.abs(after[:3]).max() < 0.5 * np.abs(before[:3]).max()
    assert np.abs(after[3:6]).max() < 0.1 * np.abs(before[3:6]).max()
    assert np.abs(after[6:]).max() < 0.1 * np.abs(before[6:]).max()


@pytest.fixture
def watched(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, start_ns: int
) -> Callable[[float, float], FeatureTable]:
    """A function (speed in m/s, seconds) to the table of a rig that goes forward, at 10 Hz."""

    def build(speed: float, seconds: float) -> FeatureTable:
        rng, table = np.random.default_rng(1), empty_table()
        for k in range(round(10 * seconds) + 1):
            T = se3.make(np.eye(3), np.array([0.1 * k * speed, 0.0, 0.0]))
            stamp = start_ns + 100_000_000 * k
            table = append_frame(table, observe(rig, T, landmarks[:100], stamp, 0.1, rng))
        return table

    return build


def looks_stationary(table: FeatureTable, rig: StereoRig, settings: ZeroVelocitySettings) -> bool:
    return image_is_stationary(table, newest_history(table, rig), rig, settings)


def test_share_counts_candidates_seen_in_both_frames() -> None:
    earlier = np.tile([100.0, 50.0, 90.0, 50.0], (40, 1))
    now = earlier.copy()
    now[:10] += 3.0
    now[10:20, 0] += 0.3  # within the noise
    earlier[20:25] = np.nan
    now[25:30] = np.nan
    assert stationary_share(now, earlier, np.arange(5, 40), 0.4) == pytest.approx(20 / 25)
    assert stationary_share(now, earlier, np.arange(20, 37), 0.4) == 0.0  # too few to say


def test_a_stationary_rig_is_detected_and_a_creeping_one_is_not(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    assert looks_stationary(watched(0.0, 1.0), rig, SETTINGS)
    assert not looks_stationary(watched(0.1, 1.0), rig, SETTINGS)


def test_points_that_look_stationary_do_not_hide_a_metric_motion(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    lenient = SETTINGS.model_copy(update={"pixel": 100.0})
    assert looks_stationary(watched(0.0, 1.0), rig, lenient)
    assert not looks_stationary(watched(0.2, 1.0), rig, lenient)


def test_a_short_history_says_nothing(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    assert not looks_stationary(watched(0.0, 0.2), rig, SETTINGS)
    assert looks_stationary(watched(0.0, 0.3), rig, SETTINGS)


def test_outliers_and_dynamic_features_have_no_say(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    table = watched(0.0, 1.0)
    everyone = mark_dynamic(table, table.feature_id)
    assert not looks_stationary(everyone, rig, SETTINGS)
    assert not looks_stationary(replace(table, outlier=~table.outlier), rig, SETTINGS)


Drive = Callable[[float, FloatArray, ImuNoise], list[MsckfFilter]]


@pytest.fixture
def drive_forward(
    rig: StereoRig, start_ns: int, landmarks: FloatArray, observe: Callable[..., FrontendFrame]
) -> Drive:
    """A function (frame rate in Hz, speeds (M,) at 100 Hz, noise) to the filter after each frame.

    The rig goes along the world's x axis; 45 % of what it sees moves about on its own.
    """

    def run(rate_hz: float, speed: FloatArray, noise: ImuNoise) -> list[MsckfFilter]:
        rng = np.random.default_rng(4)
        t = start_ns + 10_000_000 * np.arange(len(speed))
        R = so3.exp(np.array([0.05, -0.1, 0.0]))
        accel = np.gradient(speed, 0.01)[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, 9.81]
        gyro_bias, accel_bias = np.array([0.01, -0.02, 0.015]), np.array([0.03, 0.05, -0.04])
        data = noisy_imu(
            ImuData(t, np.zeros((len(t), 3)), accel @ R), noise, rng,
            gyro_bias=gyro_bias, accel_bias=accel_bias,
        ).data  # fmt: skip
        buffer = ImuBuffer()
        for stamp, gyro, force in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
            buffer.append(ImuSample(int(stamp), gyro, force))
        zero = np.zeros(3)
        known = KnownStateInitializer(
            int(t[50]), ImuState(R, zero, zero, gyro_bias, accel_bias), InitialSigmas(), rig, noise,
            Settings(),
        )  # fmt: skip
        started = known((observe(rig, se3.make(R, zero), landmarks, int(t[50])),), buffer)
        assert not isinstance(started, str)
        (ego, table), out = started, []
        movers = np.arange(100) % 20 < 9
        x = np.cumsum(speed) * 0.01
        for k, i in enumerate(range(50, len(t) - 5, round(100 / rate_hz))):
            ego = ego.propagate(int(t[i]), buffer)
            points = landmarks[:100] + movers[:, None] * np.array([0.0, 0.1 * (-1) ** k, 0.0])
            T = se3.make(R, np.array([x[i] - x[50], 0.0, 0.0]))
            table = append_frame(table, observe(rig, T, points, int(t[i]), 0.1, rng))
            # what the segmentation would say of them
            table = mark_outliers(
                table, table.feature_id, np.isin(table.feature_id, np.flatnonzero(movers))
            )
            ego, table = ego.update(table, newest_history(table, rig))
            ego, table = ego.marginalize(table)
            buffer.drop_before(int(t[i]) - 1_000_000_000)
            out.append(ego)
        return out

    return run


def test_a_stationary_minute_drifts_less_than_a_centimetre(
    drive_forward: Drive, noise: ImuNoise
) -> None:
    egos = drive_forward(5.0, np.zeros(6100), noise)
    assert len(egos) > 295
    assert all(ego.stationary for ego in egos[3:])  # the first have nothing to look back at
    assert max(np.linalg.norm(ego.state.imu.position) for ego in egos) < 0.01
    assert np.linalg.norm(egos[-1].state.imu.velocity) < 0.01
    assert len(egos[-1].state.clones) <= 4


@pytest.mark.parametrize("rate_hz", [10.0, 20.0])
@pytest.mark.parametrize("speed", [0.1, 0.2, 0.5, 3.0])
def test_a_rig_that_starts_to_move_is_not_held_back(
    drive_forward: Drive, noise: ImuNoise, rate_hz: float, speed: float
) -> None:
    profile = np.clip(np.arange(700) / 100.0 - 2.5, 0.0, 1.0) * speed  # stationary, then moving
    egos = drive_forward(rate_hz, profile, noise)
    way = float(np.sum(profile[51:]) * 0.01)
    moving = egos[round(3.5 * rate_hz) :]
    assert sum(ego.stationary for ego in egos[: round(1.5 * rate_hz)]) > rate_hz / 2
    assert sum(ego.stationary for ego in moving) <= 2
    assert float(egos[-1].state.imu.position[0]) == pytest.approx(way, rel=0.1)
