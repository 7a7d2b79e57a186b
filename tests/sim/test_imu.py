"""The exact IMU integrates back to its path; the noise has the densities that were asked for."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu import GRAVITY_MPS2, noisy_imu, perfect_imu
from ovmot.sim.paths import drive_path, standing_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.types import ImuData, ImuNoise

ORIGIN = 1_500_000_000_000_000_000


@pytest.fixture(scope="module")
def path() -> PoseSpline:
    road = Road(SmoothSteps.make((0.0, 0.0), (10.0, 0.03)), 60.0)
    speed = SmoothSteps.make((0.5, 0.0), (2.5, 8.0), (3.0, 8.0), (5.0, 0.0))
    mount = se3.make(so3.exp(np.array([0.02, -0.05, 0.4])), np.array([1.0, 0.2, 1.5]))
    return drive_path(road, speed, ORIGIN, 5.0, np.random.default_rng(4), T_vehicle_body=mount)


def integrate(imu: ImuData, path: PoseSpline) -> np.ndarray:
    """Strapdown integration with the midpoint rule: T_world_imu (N, 4, 4) at the samples."""
    T = path.pose(int(imu.timestamp_ns[0]))
    R, p, v = T[:3, :3], T[:3, 3], path.velocity(int(imu.timestamp_ns[0]))
    gravity = np.array([0.0, 0.0, -GRAVITY_MPS2])
    poses = [T]
    for i, dt in enumerate(1e-9 * np.diff(imu.timestamp_ns)):
        R_next = R @ so3.exp(0.5 * (imu.gyro[i] + imu.gyro[i + 1]) * dt)
        a = 0.5 * (R @ imu.accel[i] + R_next @ imu.accel[i + 1]) + gravity
        p, v, R = p + v * dt + 0.5 * a * dt**2, v + a * dt, R_next
        poses.append(se3.make(R, p))
    return np.array(poses)


def end_error(path: PoseSpline, rate_hz: int) -> tuple[float, float]:
    times = ORIGIN + np.arange(5 * rate_hz + 1) * (10**9 // rate_hz)
    reached, truth = integrate(perfect_imu(path, times), path)[-1], path.pose(int(times[-1]))
    angle = np.linalg.norm(so3.log(reached[:3, :3].T @ truth[:3, :3]))
    return float(np.linalg.norm(reached[:3, 3] - truth[:3, 3])), float(angle)


def test_noiseless_samples_integrate_back_to_the_path_at_the_rule_s_order(path: PoseSpline) -> None:
    coarse, fine = end_error(path, 100), end_error(path, 200)
    assert fine[0] < 5e-3
    assert fine[1] < 1e-4
    assert 3.0 < coarse[0] / fine[0] < 5.0  # the midpoint rule is of second order


def test_resting_imu_reads_gravity_only() -> None:
    R = so3.exp(np.array([0.1, 0.2, 0.3]))
    rest = standing_path(se3.make(R, np.zeros(3)), ORIGIN, 2.0)
    imu = perfect_imu(rest, ORIGIN + np.arange(10) * 10_000_000)
    np.testing.assert_allclose(imu.gyro, 0.0, atol=1e-12)
    np.testing.assert_allclose(imu.accel @ R.T, [[0.0, 0.0, GRAVITY_MPS2]] * 10, atol=1e-9)


def test_time_offset_delays_the_stamps(path: PoseSpline) -> None:
    times = ORIGIN + 10**9 + np.arange(50) * 10**7
    late = perfect_imu(path, times + 20_000_000, time_offset_s=0.02)
    exact = perfect_imu(path, times)
    np.testing.assert_allclose(late.gyro, exact.gyro, atol=1e-12)
    np.testing.assert_array_equal(late.timestamp_ns, times + 20_000_000)


def test_noise_and_walk_have_their_densities() -> None:
    count, rate = 40_000, 100.0
    times = ORIGIN + np.arange(count) * 10_000_000
    silent = ImuData(times, np.zeros((count, 3)), np.zeros((count, 3)))
    noise = ImuNoise(gyro=1e-3, gyro_walk=2e-4, accel=1e-2, accel_walk=3e-3)
    bias = np.array([0.1, 0.2, 0.3])
    made = noisy_imu(silent, noise, np.random.default_rng(0), gyro_bias=bias, accel_bias=-bias)
    np.testing.assert_array_equal(made.gyro_bias[0], bias)
    np.testing.assert_array_equal(made.accel_bias[0], -bias)
    white = made.data.gyro - made.gyro_bias, made.data.accel - made.accel_bias
    for values, density in zip(white, (noise.gyro, noise.accel), strict=True):
        np.testing.assert_allclose(values.std(axis=0), density * np.sqrt(rate), rtol=0.02)
    for walk, density in ((made.gyro_bias, noise.gyro_walk), (made.accel_bias, noise.accel_walk)):
        step = np.diff(walk, axis=0).std(axis=0)
        np.testing.assert_allclose(step, density / np.sqrt(rate), rtol=0.02)
    again = noisy_imu(silent, noise, np.random.default_rng(0), gyro_bias=bias, accel_bias=-bias)
    np.testing.assert_array_equal(made.data.gyro, again.data.gyro)
