"""The filter as a whole: its health, its place after a reset, and its state between frames."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import append_frame, empty_table
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.settings import Settings
from ovmot.sim.imu import perfect_imu
from ovmot.types import FrontendFrame, Health, ImuNoise, ImuSample
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import (
    POSITION,
    THETA,
    VELOCITY,
    ImuState,
    State,
    box_minus,
    box_plus,
    no_clones,
    pose_matrix,
)

FRAME_NS = 100_000_000


@pytest.fixture
def ego(rig: StereoRig, curvy_path: PoseSpline, noise: ImuNoise, start_ns: int) -> MsckfFilter:
    """A filter that starts at the truth."""
    T, zero = curvy_path.pose(start_ns), np.zeros(3)
    imu = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), zero, zero)
    P = np.diag(np.repeat([1e-3, 1e-3, 1e-2, 1e-3, 1e-2], 3) ** 2)
    covariance = np.zeros((16, 16))
    covariance[:15, :15] = P
    state = State(start_ns, imu, imu, 0.0, no_clones(), covariance)
    return MsckfFilter(state, rig, noise, Settings())


@pytest.fixture
def imu(curvy_path: PoseSpline, start_ns: int) -> ImuBuffer:
    buffer = ImuBuffer()
    stamps = start_ns + 5_000_000 * np.arange(-10, 1390)
    data = perfect_imu(curvy_path, stamps)
    for stamp, gyro, accel in zip(stamps, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    return buffer


def test_without_features_health_falls_and_comes_back(
    ego: MsckfFilter, imu: ImuBuffer, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], start_ns: int,
) -> None:  # fmt: skip
    table, healths = empty_table(), []
    for k in range(65):
        stamp = start_ns + FRAME_NS * k
        dark = 10 <= k < 45
        points = landmarks[:0] if dark else landmarks
        table = append_frame(table, observe(rig, curvy_path.pose(stamp), points, stamp))
        ego = ego.propagate(stamp, imu)
        ego, table = ego.update(table)
        healths.append(ego.health(stamp))
        ego, table = ego.marginalize(table)
    assert healths[9] == Health.TRACKING
    assert healths[12] == Health.TRACKING  # features that end are an update still
    assert healths[18] == Health.DEGRADED
    assert healths[44] == Health.DEGRADED
    assert healths[64] == Health.TRACKING
    hopeless = replace(ego, corrected_ns=start_ns)
    assert hopeless.health(start_ns + 64 * FRAME_NS) == Health.LOST


def test_an_unsure_velocity_is_lost(ego: MsckfFilter, start_ns: int) -> None:
    P = ego.state.covariance.copy()
    P[VELOCITY, VELOCITY] = 16.0 * np.eye(3)
    assert replace(ego, state=replace(ego.state, covariance=P)).health(start_ns) == Health.LOST
    assert ego.health(start_ns) == Health.TRACKING


def test_placed_at_a_pose_it_keeps_tilt_speed_and_uncertainty(ego: MsckfFilter) -> None:
    there = se3.make(so3.exp(np.array([0.2, -0.1, 2.0])), np.array([7.0, -3.0, 1.0]))
    placed = ego.placed(there)
    np.testing.assert_allclose(placed.state.imu.position, there[:3, 3])
    turn = placed.state.imu.R_world_imu @ ego.state.imu.R_world_imu.T
    np.testing.assert_allclose(turn[2], [0.0, 0.0, 1.0], atol=1e-12)  # about the vertical alone

    # no turn about the vertical brings it nearer to the heading asked for
    def apart(yaw: float) -> float:
        R = so3.exp(np.array([0.0, 0.0, yaw])) @ placed.state.imu.R_world_imu
        return float(np.linalg.norm(so3.log(R.T @ there[:3, :3])))

    assert apart(0.0) < min(apart(0.05), apart(-0.05))
    np.testing.assert_allclose(placed.state.imu.velocity, turn @ ego.state.imu.velocity)
    before, after = ego.state.covariance, placed.state.covariance
    np.testing.assert_allclose(after[THETA, THETA], before[THETA, THETA], atol=1e-15)
    turned = turn @ before[POSITION, POSITION] @ turn.T
    np.testing.assert_allclose(after[POSITION, POSITION], turned, atol=1e-15)


def test_a_window_is_placed_as_one_by_its_first_pose(
    ego: MsckfFilter,
    make_state: Callable[..., State],
    central_differences: Callable[..., FloatArray],
) -> None:
    there = se3.make(so3.exp(np.array([0.1, 0.0, -1.0])), np.array([7.0, -3.0, 1.0]))
    before = replace(ego, state=make_state(np.random.default_rng(2), 3))
    after = before.placed(there).state
    T, was = after.clones.T_world_imu, before.state.clones.T_world_imu
    np.testing.assert_allclose(T[0, :3, 3], there[:3, 3], atol=1e-12)
    np.testing.assert_allclose(se3.inverse(T[0]) @ T, se3.inverse(was[0]) @ was, atol=1e-12)
    np.testing.assert_array_equal(after.clones.T_world_imu_first, T)
    newest, newest_was = pose_matrix(after.imu), pose_matrix(before.state.imu)
    np.testing.assert_allclose(
        se3.inverse(T[0]) @ newest, se3.inverse(was[0]) @ newest_was, atol=1e-12
    )
    # the covariance is that of the state turned and shifted, by which place is arbitrary
    T_new_old = T[0] @ se3.inverse(was[0])

    def moved(error: FloatArray) -> FloatArray:
        state = box_plus(before.state, error)
        imu = replace(
            state.imu,
            R_world_imu=T_new_old[:3, :3] @ state.imu.R_world_imu,
            position=se3.apply(T_new_old, state.imu.position),
            velocity=T_new_old[:3, :3] @ state.imu.velocity,
        )
        clones = replace(state.clones, T_world_imu=T_new_old @ state.clones.T_world_imu)
        return box_minus(replace(state, imu=imu, clones=clones), after)

    P = before.state.covariance
    G = central_differences(moved, np.zeros(len(P)))
    np.testing.assert_allclose(after.covariance, G @ P @ G.T, atol=1e-8)


def test_the_state_between_frames(
    ego: MsckfFilter, imu: ImuBuffer, curvy_path: PoseSpline, start_ns: int
) -> None:
    ego = ego.propagate(start_ns, imu)
    between = start_ns + 37_000_000
    estimate = ego.estimate_at(between, imu)
    assert estimate.timestamp_ns == between
    truth = curvy_path.pose(between)
    np.testing.assert_allclose(estimate.T_world_imu, truth, atol=1e-4)
    np.testing.assert_allclose(estimate.velocity, curvy_path.velocity(between), atol=1e-3)
    # as if a frame had come, and the filter itself is as it was
    np.testing.assert_allclose(
        estimate.covariance, ego.propagate(between, imu).state.covariance[:15, :15], rtol=1e-9
    )
    assert ego.state.timestamp_ns == start_ns
    assert np.trace(estimate.covariance) > np.trace(ego.state.covariance[:15, :15])
    with pytest.raises(DatasetError):
        ego.estimate_at(start_ns + 10**11, imu)
