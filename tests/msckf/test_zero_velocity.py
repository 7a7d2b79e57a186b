"""Standing still: recognised while others move, refused while creeping, and held for a minute."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.config import Settings, ZeroVelocitySettings
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.imu_buffer import ImuBuffer
from ovmot.msckf.ego import FilterEgo
from ovmot.msckf.start_at_rest import StartPrior, start_at_rest
from ovmot.msckf.state import VELOCITY, Clones, State, box_plus, clone_columns, drop_clone
from ovmot.msckf.zero_velocity import (
    is_standing,
    standing_measurement,
    still_share,
    zero_velocity_update,
)
from ovmot.sim.imu import noisy_imu
from ovmot.tracks import append_frame, empty_table
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample

SETTINGS = ZeroVelocitySettings()
Derivative = Callable[..., FloatArray]


@pytest.fixture
def resting(make_state: Callable[..., State]) -> State:
    """Two clones at the same place, velocity zero, everything known to a driving filter's sigma."""
    state = make_state(np.random.default_rng(1), 2)
    T = np.repeat(state.clones.T_world_imu[:1], 2, axis=0)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    P[VELOCITY, VELOCITY] = 0.02**2 * np.eye(3)
    # clones of one filter share their errors: their difference is known far better than they are
    a, b = clone_columns(0), clone_columns(1)
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
    H, columns, residual, variance = standing_measurement(state)
    n = len(state.covariance)
    H_full = np.zeros((len(residual), n))
    H_full[:, columns] = H
    expected = -central_differences(
        lambda e: standing_measurement(box_plus(state, e))[2], np.zeros(n)
    )
    np.testing.assert_allclose(H_full, expected, atol=1e-7)
    assert (variance > 0.0).all()


def test_share_counts_candidates_seen_in_both_frames() -> None:
    earlier = np.tile([100.0, 50.0], (40, 1))
    now = earlier.copy()
    now[:10] += 3.0
    now[10:20, 0] += 0.3  # within the noise
    earlier[20:25] = np.nan
    now[25:30] = np.nan
    candidates = np.arange(40) >= 5
    assert still_share(now, earlier, candidates, 0.4) == pytest.approx(20 / 25)
    assert still_share(now, earlier, np.arange(40) < 7, 0.4) == 0.0  # too few to say


def test_standing_though_45_percent_of_the_points_move(resting: State) -> None:
    rng = np.random.default_rng(3)
    earlier = rng.uniform(0.0, 400.0, (100, 2))
    now = earlier + rng.normal(0.0, 0.1, earlier.shape)
    now[:45] += [6.0, 0.5]
    share = still_share(now, earlier, np.ones(100, dtype=np.bool_), SETTINGS.pixel)
    assert share == pytest.approx(0.55)
    assert is_standing(resting, share, SETTINGS)


@pytest.mark.parametrize("direction", [0, 1, 2])
def test_creeping_behind_cars_that_look_still_is_no_standing(
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
    assert not is_standing(creeping, 0.9, SETTINGS)


def test_turning_on_the_spot_is_no_standing(resting: State) -> None:
    T = resting.clones.T_world_imu.copy()
    T[1, :3, :3] = T[1, :3, :3] @ so3.exp(np.array([0.0, 0.0, 0.02]))
    turning = replace(resting, clones=replace(resting.clones, T_world_imu=T))
    assert not is_standing(turning, 0.9, SETTINGS)


def test_picture_and_settings_must_allow_it(resting: State) -> None:
    assert not is_standing(resting, 0.45, SETTINGS)
    assert not is_standing(resting, 0.9, ZeroVelocitySettings(enabled=False))
    one = drop_clone(resting, 0)
    assert not is_standing(one, 0.9, SETTINGS)


def test_update_takes_out_velocity_and_motion(resting: State) -> None:
    T = resting.clones.T_world_imu.copy()
    T[1, :3, 3] += [0.004, -0.003, 0.002]
    T[1, :3, :3] = T[1, :3, :3] @ so3.exp(np.array([1e-3, -5e-4, 8e-4]))
    moved = replace(
        resting,
        imu=replace(resting.imu, velocity=np.array([0.02, 0.01, -0.02])),
        clones=replace(resting.clones, T_world_imu=T),
        covariance=resting.covariance + 1e-3 * np.eye(len(resting.covariance)),
    )
    still = zero_velocity_update(moved)
    before, after = standing_measurement(moved)[2], standing_measurement(still)[2]
    assert np.abs(after[:3]).max() < 0.5 * np.abs(before[:3]).max()
    assert np.abs(after[3:6]).max() < 0.1 * np.abs(before[3:6]).max()
    assert np.abs(after[6:]).max() < 0.1 * np.abs(before[6:]).max()


def test_a_minute_of_standing_drifts_less_than_a_centimetre(
    rig: StereoRig, noise: ImuNoise, start_ns: int, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame],
) -> None:  # fmt: skip
    rng = np.random.default_rng(4)
    rate_hz, frame_step = 100, 20  # 5 frames a second
    t = start_ns + 10_000_000 * np.arange(61 * rate_hz)
    R = so3.exp(np.array([0.05, -0.1, 0.0]))
    level = np.ones((len(t), 1))
    clean = ImuData(t, 0.0 * level * np.ones(3), level * (R.T @ [0.0, 0.0, 9.81]))
    data = noisy_imu(
        clean, noise, rng,
        gyro_bias=np.array([0.01, -0.02, 0.015]), accel_bias=np.array([0.03, 0.05, -0.04]),
    ).data  # fmt: skip
    buffer = ImuBuffer()
    for stamp, gyro, accel in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    begin = buffer.between(start_ns, int(t[rate_hz // 2]))
    ego = FilterEgo(
        start_at_rest(begin, noise, StartPrior(9.81, 0.0, 0.005, 0.05)), rig, noise, Settings()
    )
    ego, table = ego.predict(int(t[rate_hz // 2]), buffer), empty_table()
    T_world_imu = se3.make(R, np.zeros(3))
    landmarks = landmarks[:100]
    movers = np.arange(len(landmarks)) % 20 < 9  # 45 % of what is seen
    standing, farthest = [], 0.0
    for k, stamp in enumerate(t[rate_hz // 2 + frame_step :: frame_step]):
        ego = ego.predict(int(stamp), buffer)
        points = landmarks + movers[:, None] * np.array([0.0, 0.1 * (-1) ** k, 0.0])
        table = append_frame(table, observe(rig, T_world_imu, points, int(stamp), 0.1, rng))
        ego, table = ego.correct(table, np.zeros(table.shape[1], dtype=np.bool_))
        ego, table = ego.forget(table)
        buffer.forget_before(int(stamp) - 1_000_000_000)
        standing.append(ego.standing)
        farthest = max(farthest, float(np.linalg.norm(ego.state.imu.position)))
    assert len(standing) > 295
    assert all(standing[1:])  # the first frame has no other to compare with
    assert farthest < 0.01
    assert np.linalg.norm(ego.state.imu.velocity) < 0.01
    assert len(ego.state.clones) <= 2
