"""Poses from a file in the filter's place."""

import numpy as np
import pytest
from histories import newest_history

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import append_frame, empty_table
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import GivenEgoSettings
from ovmot.types import FrontendFrame
from ovmot.vio.given_poses import GivenPoses, GivenPosesInitializer, imu_poses_from_cam0
from ovmot.vio.imu_buffer import ImuBuffer

SETTINGS = GivenEgoSettings(rotation_sigma_rad=2e-3, position_sigma_m=0.05, window=4)
STAMPS: IntArray = 100 * np.arange(1, 9, dtype=np.int64) * 1_000_000
IMU = ImuBuffer()


def poses() -> FloatArray:
    t = np.arange(8.0)
    R = so3.exp(np.stack([0 * t, 0 * t, 0.1 * t], axis=1))
    return se3.make(R, np.stack([0.5 * t, 0.1 * t**2, 0 * t], axis=1))


@pytest.fixture
def ego(painted_rig: StereoRig) -> GivenPoses:
    return GivenPoses(STAMPS, poses(), painted_rig, SETTINGS)


def seen(stamp: int) -> FrontendFrame:
    pixels = np.full((1, 4), 10.0)
    return FrontendFrame(
        stamp, np.array([7]), pixels, pixels, np.array([0]), np.ones(1, dtype=np.bool_)
    )


def test_a_frame_gets_its_own_pose(ego: GivenPoses) -> None:
    for i in (0, 1, 2):
        ego = ego.propagate(int(STAMPS[i]), IMU)
        np.testing.assert_array_equal(ego.estimate(int(STAMPS[i])).T_world_imu, poses()[i])
    np.testing.assert_array_equal(ego.window().T_world_imu, poses()[:3])
    np.testing.assert_array_equal(ego.window().timestamp_ns, STAMPS[:3])


@pytest.mark.parametrize("stamp", [50_000_000, 150_000_000, 900_000_000])
def test_a_frame_without_a_pose_is_an_error_and_never_another_s(
    ego: GivenPoses, stamp: int
) -> None:
    with pytest.raises(DatasetError, match=f"no pose is given for the frame at {stamp} ns"):
        ego.propagate(stamp, IMU)


def test_the_window_drops_the_oldest_with_its_rows(ego: GivenPoses) -> None:
    table = empty_table()
    for stamp in STAMPS.tolist():
        ego = ego.propagate(stamp, IMU)
        table = append_frame(table, seen(stamp))
        ego, table = ego.update(table, newest_history(table, ego.rig))
        ego, table = ego.marginalize(table)
    np.testing.assert_array_equal(ego.window().timestamp_ns, STAMPS[-4:])
    np.testing.assert_array_equal(table.frame_ns, STAMPS[-4:])


def test_the_covariance_is_as_told(ego: GivenPoses) -> None:
    ego = ego.propagate(int(STAMPS[0]), IMU).propagate(int(STAMPS[1]), IMU)
    variance = np.array([2e-3] * 3 + [0.05] * 3) ** 2
    np.testing.assert_allclose(ego.window().covariance, np.diag(np.tile(variance, 2)))
    estimate = ego.estimate(int(STAMPS[1]))
    np.testing.assert_allclose(estimate.covariance[:6, :6], np.diag(variance))
    assert np.isnan(estimate.covariance[6:]).all()
    assert np.isnan(estimate.gyro_bias).all()
    assert np.isnan(estimate.accel_bias).all()


def test_velocity_is_the_difference_of_the_last_two_poses(ego: GivenPoses) -> None:
    ego = ego.propagate(int(STAMPS[2]), IMU)
    assert np.isnan(ego.estimate(int(STAMPS[2])).velocity).all()
    ego = ego.propagate(int(STAMPS[4]), IMU)  # a frame between was left out
    moved = poses()[4, :3, 3] - poses()[2, :3, 3]
    np.testing.assert_allclose(ego.estimate(int(STAMPS[4])).velocity, moved / 0.2)


def test_it_starts_at_once_and_needs_no_imu(ego: GivenPoses) -> None:
    start = GivenPosesInitializer(ego)
    source, table = start((seen(int(STAMPS[0])),), IMU)
    assert source is ego
    assert table.shape == (0, 0)
    assert start.imu_needed_until(5) is None
    assert ego.imu_needed_until(5) is None
    assert not ego.estimate(int(ego.pose_ns[0])).standing


def test_camera_poses_become_imu_poses(painted_rig: StereoRig) -> None:
    T_world_cam0 = poses() @ painted_rig.T_imu_cam0
    np.testing.assert_allclose(imu_poses_from_cam0(T_world_cam0, painted_rig), poses(), atol=1e-12)


def test_the_predicted_motion_is_that_of_the_given_poses(painted_rig: StereoRig) -> None:
    """Going 0.2 m to the left, what was straight ahead is 0.2 m to the right (+x)."""
    T = np.stack([np.eye(4)] * 2)
    T[1, 1, 3] = 0.2
    ego = GivenPoses(np.array([1, 2]), T, painted_rig, SETTINGS)
    moved = se3.apply(ego.predicted_motion(1, 2, ImuBuffer()), np.array([0.0, 0.0, 5.0]))
    np.testing.assert_allclose(moved, [0.2, 0.0, 5.0], atol=1e-12)
    with pytest.raises(DatasetError, match="no pose is given for the frame at 3 ns"):
        ego.predicted_motion(2, 3, ImuBuffer())
