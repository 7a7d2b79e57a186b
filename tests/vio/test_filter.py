"""The filter as a whole: consistency, window, health, place after a reset, state between frames."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drive_fixtures import OFFSET_SIGMA, SIGMA, Drive, filled_window, pose_error
from histories import newest_history

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import append_frame, empty_table
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.settings import Settings
from ovmot.sim.imu import perfect_imu
from ovmot.types import FrontendFrame, Health, ImuNoise, ImuSample
from ovmot.vio import visual_update
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import (
    GYRO_BIAS,
    N_BASE,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    ImuState,
    State,
    box_minus,
    box_plus,
    no_clones,
    pose_matrix,
)

FRAME_NS = 100_000_000
MakeDrive = Callable[..., Drive]


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
        ego, table = ego.update(table, newest_history(table, ego.rig))
        healths.append(ego.health(stamp))
        ego, table = ego.marginalize(table)
    assert healths[9] == Health.TRACKING
    assert healths[12] == Health.TRACKING  # features that end are an update still
    assert healths[18] == Health.DEGRADED
    assert healths[44] == Health.DEGRADED
    assert healths[64] == Health.TRACKING
    hopeless = replace(ego, updated_ns=start_ns)
    assert hopeless.health(start_ns + 64 * FRAME_NS) == Health.LOST


def test_an_unsure_velocity_is_lost(ego: MsckfFilter, start_ns: int) -> None:
    P = ego.state.covariance.copy()
    P[VELOCITY, VELOCITY] = 16.0 * np.eye(3)
    assert replace(ego, state=replace(ego.state, covariance=P)).health(start_ns) == Health.LOST
    assert ego.health(start_ns) == Health.TRACKING


@pytest.mark.parametrize(
    ("missing", "frames", "unmeasured_s"),
    [
        (range(41, 60), (20, 40, 60), 0.1),  # 95 ms: no gap
        (range(41, 120), (20, 40, 60, 80, 120), 0.0),  # frames in the gap
        (range(41, 90), (20, 40, 90), 0.25),
        (range(42, 91), (20, 40, 90, 110), 0.245),  # not quite between the same two frames
        (range(41, 120), (20, 40, 120), 0.4),
    ],
)
def test_a_gap_that_imu_and_frames_share_is_not_trusted(
    ego: MsckfFilter, curvy_path: PoseSpline, start_ns: int,
    missing: range, frames: tuple[int, ...], unmeasured_s: float,
) -> None:  # fmt: skip
    """Frames and samples by number, 5 ms apart: position unsure by as much as it moves then."""
    buffer, longest, sigma = ImuBuffer(), 0.0, []
    stamps = start_ns + 5_000_000 * np.arange(-10, 300)
    data = perfect_imu(curvy_path, stamps)
    for k, stamp in enumerate(stamps.tolist(), start=-10):
        if k not in missing:
            buffer.append(ImuSample(stamp, data.gyro[k + 10], data.accel[k + 10]))
    healths = []
    for k in frames:
        ego = ego.propagate(start_ns + 5_000_000 * k, buffer)
        longest = max(longest, ego.unmeasured_s)
        healths.append(ego.health(start_ns + 5_000_000 * k))
        sigma.append(float(np.sqrt(np.trace(ego.state.covariance[POSITION, POSITION]))))
    unmeasured_s = 0.0 if unmeasured_s <= 0.1 else unmeasured_s
    assert longest == pytest.approx(unmeasured_s, abs=1e-3)
    assert (Health.LOST in healths) == (unmeasured_s > 0.3)
    speed = float(np.linalg.norm(ego.state.imu.velocity))
    if unmeasured_s:
        assert sigma[-1] > 0.5 * unmeasured_s * speed


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


def test_the_motion_to_come_is_predicted(
    ego: MsckfFilter, imu: ImuBuffer, curvy_path: PoseSpline, start_ns: int, rig: StereoRig
) -> None:
    ego = ego.propagate(start_ns, imu)
    before, now = start_ns + 100_000_000, start_ns + 200_000_000
    predicted = ego.predicted_motion(before, now, imu)
    T_world_cam0 = np.stack([curvy_path.pose(t) for t in (before, now)]) @ rig.T_imu_cam0
    truth = se3.inverse(T_world_cam0[1]) @ T_world_cam0[0]
    np.testing.assert_allclose(predicted, truth, atol=1e-4)
    with pytest.raises(DatasetError):
        ego.predicted_motion(before, start_ns + 10**11, imu)


def test_errors_are_as_large_as_the_covariance_says(make_drive: MakeDrive) -> None:
    nees, last = [], []
    for seed in range(10):
        drive = make_drive(seed)
        for step in drive.run():
            e, P = pose_error(step.ego, drive.path)
            nees.append(e @ np.linalg.solve(P, e))
        last.append(e[3:] / np.sqrt(np.diag(P)[3:]))
        sigma = np.sqrt(np.diag(step.ego.state.covariance))
        # after 15 m the images have estimated them
        assert sigma[GYRO_BIAS].max() < 0.002
        assert sigma[THETA].max() < 0.01
        assert sigma[TIME_OFFSET] < 0.6 * OFFSET_SIGMA
    assert np.abs(last).max() < 3.0
    assert 4.0 < np.mean(nees) < 9.0  # 6 degrees of freedom


def test_a_moving_rig_is_not_stationary_whatever_the_images_show(make_drive: MakeDrive) -> None:
    drive = make_drive(1, 2.0)
    assert not any(step.ego.stationary for step in drive.run())
    # the same image again and again is not enough while the IMU says that we drive
    frozen = [replace(drive.frames[0], timestamp_ns=f.timestamp_ns) for f in drive.frames]
    assert not any(step.ego.stationary for step in replace(drive, frames=frozen[:4]).run())


def test_monocular_features_update_too(make_drive: MakeDrive) -> None:
    drive = make_drive(9, 3.0)
    mono = []
    for frame in drive.frames:
        pixels, normalized = frame.pixels.copy(), frame.normalized.copy()
        pixels[:, 2:] = normalized[:, 2:] = np.nan
        mono.append(replace(frame, pixels=pixels, normalized=normalized))
    *_, step = replace(drive, frames=mono).run()
    e, P = pose_error(step.ego, drive.path)
    assert e @ np.linalg.solve(P, e) < 22.5  # 99.9 % of chi-squared with 6
    sigma = np.sqrt(np.diag(step.ego.state.covariance))
    assert sigma[GYRO_BIAS].max() < 0.6 * SIGMA[GYRO_BIAS].max()


def test_a_stationary_rig_marginalizes_the_newest_clone_and_its_rows_point_to_the_kept_one(
    make_drive: MakeDrive,
) -> None:
    ego, table = filled_window(make_drive(10, 1.0), 4)
    stamps = ego.state.clones.timestamp_ns
    stationary, shared = replace(ego, stationary=True).marginalize(table)
    np.testing.assert_array_equal(stationary.state.clones.timestamp_ns, stamps[:-1])
    np.testing.assert_array_equal(shared.clone_ns, [*stamps[:-1], stamps[-2]])
    np.testing.assert_array_equal(shared.frame_ns, stamps)
    # the shared row is no measurement of the filter's
    np.testing.assert_array_equal(
        visual_update.clone_rows(shared, stationary.state), [True, True, True, False]
    )
    assert not visual_update.available_observations(shared, stationary.state)[-1].any()


def test_a_moving_rig_marginalizes_the_oldest_clone_of_a_full_window(make_drive: MakeDrive) -> None:
    drive = make_drive(11, 2.0)
    n = drive.ego.settings.filter.max_clones
    ego, table = filled_window(drive, n)
    same, _ = ego.marginalize(table)
    assert len(same.state.clones) == n
    ego, table = filled_window(drive, n + 1)
    stamps = ego.state.clones.timestamp_ns
    less, table = ego.marginalize(table)
    np.testing.assert_array_equal(less.state.clones.timestamp_ns, stamps[1:])
    np.testing.assert_array_equal(table.frame_ns, stamps[1:])
    assert less.state.covariance.shape == (N_BASE + 6 * n, N_BASE + 6 * n)


def test_propagation_clones_the_pose_of_the_frame(make_drive: MakeDrive) -> None:
    drive = make_drive(13, 1.0)
    ego, _ = filled_window(drive, 5)
    stamp = drive.frames[4].timestamp_ns
    assert ego.state.timestamp_ns == ego.imu_needed_until(stamp) == ego.imu_time_ns(stamp)
    assert ego.state.clones.timestamp_ns[-1] == stamp
    np.testing.assert_array_equal(ego.window().T_world_imu[-1], ego.estimate(stamp).T_world_imu)
    # a later moment of the frame is farther along the way and the turn
    by_offset = ego.state.covariance[-6:, TIME_OFFSET] / OFFSET_SIGMA**2
    rate = drive.path.angular_velocity(stamp)
    np.testing.assert_allclose(by_offset[:3], rate, atol=0.1)
    np.testing.assert_allclose(by_offset[3:], ego.state.imu.velocity, atol=1e-9)
    assert np.linalg.norm(rate) > 0.2


def test_estimate_and_window_are_the_state(make_drive: MakeDrive) -> None:
    ego, _ = filled_window(make_drive(12, 1.0), 3)
    estimate, window = ego.estimate(77), ego.window()
    assert estimate.timestamp_ns == 77
    np.testing.assert_array_equal(estimate.T_world_imu[:3, 3], ego.state.imu.position)
    np.testing.assert_array_equal(estimate.T_world_imu[:3, :3], ego.state.imu.R_world_imu)
    np.testing.assert_array_equal(estimate.covariance, ego.state.covariance[:15, :15])
    assert estimate.time_offset_std_s == pytest.approx(OFFSET_SIGMA)
    np.testing.assert_array_equal(window.T_world_imu, ego.state.clones.T_world_imu)
    np.testing.assert_array_equal(window.covariance, ego.state.covariance[N_BASE:, N_BASE:])


def test_clones_of_fast_frames_leave_before_the_newest(make_drive: MakeDrive) -> None:
    drive = make_drive(0, 2.0)
    settings = Settings.model_validate({"filter": {"clone_spacing_s": 0.2, "max_clones": 6}})
    ego = replace(drive.ego, settings=settings)
    table = empty_table()
    for frame in drive.frames:
        ego = ego.propagate(frame.timestamp_ns, drive.imu)
        table = append_frame(table, frame)
        ego, table = ego.update(table, newest_history(table, ego.rig))
        ego, table = ego.marginalize(table)
        assert ego.window().timestamp_ns[-1] == frame.timestamp_ns
    gaps = np.diff(ego.window().timestamp_ns) * 1e-9
    # no two neighbours of a clone are nearer to each other than the spacing
    assert (gaps[:-1] + gaps[1:] > 0.2).all()
    assert gaps[:-1].max() <= 0.2 + 1e-9
