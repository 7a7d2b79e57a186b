"""The exact IMU integrates back to its path; the noise has the densities that were asked for."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.pose_files import write_tum
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu import GRAVITY_MPS2, noisy_imu, perfect_imu
from ovmot.sim.paths import drive_path, standing_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.recorded_paths import recorded_path
from ovmot.sim.walk import stroll, walk_path
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import Integrator, integrate_discrete, integrate_rk4

ORIGIN = 1_500_000_000_000_000_000


def drive() -> PoseSpline:
    road = Road(SmoothSteps.make((0.0, 0.0), (10.0, 0.03)), 60.0)
    speed = SmoothSteps.make((0.5, 0.0), (2.5, 8.0), (3.0, 8.0), (5.0, 0.0))
    mount = se3.make(so3.exp(np.array([0.02, -0.05, 0.4])), np.array([1.0, 0.2, 1.5]))
    return drive_path(road, speed, ORIGIN, 5.0, np.random.default_rng(4), T_vehicle_body=mount)


def walk() -> PoseSpline:
    rng = np.random.default_rng(4)
    mount = se3.make(so3.exp(np.array([0.2, -0.5, 0.4])), np.array([0.3, 0.0, 1.4]))
    return walk_path(*stroll(5.0, rng), ORIGIN, 5.0, rng, T_walker_body=mount)


def integrate(imu: ImuData, path: PoseSpline, integrator: Integrator) -> FloatArray:
    """The pose (4, 4) at the last sample, by the filter's own increments from the first one on."""
    start_ns = int(imu.timestamp_ns[0])
    T, v = path.pose(start_ns), path.velocity(start_ns)
    R, p = T[:3, :3], T[:3, 3]
    gravity = np.array([0.0, 0.0, -GRAVITY_MPS2])
    parts = integrator(imu.gyro, imu.accel, 1e-9 * np.diff(imu.timestamp_ns))
    for turn, dv, dp, h in zip(
        parts.rotation, parts.velocity, parts.position, parts.dt, strict=True
    ):
        p = p + v * h + 0.5 * gravity * h * h + R @ dp
        v = v + gravity * h + R @ dv
        R = R @ turn
    return se3.make(R, p)


def end_error(
    path: PoseSpline, rate_hz: int, integrator: Integrator, time_offset_s: float = 0.0
) -> tuple[float, float]:
    """Position (m) and rotation (rad) missed after 5 s of exact samples at this rate."""
    offset_ns = round(1e9 * time_offset_s)
    times = ORIGIN + np.arange(5 * rate_hz + 1) * (10**9 // rate_hz)
    late = perfect_imu(path, times + offset_ns, time_offset_s=time_offset_s)
    imu = ImuData(late.timestamp_ns - offset_ns, late.gyro, late.accel)
    reached, truth = integrate(imu, path, integrator), path.pose(int(times[-1]))
    angle = np.linalg.norm(so3.log(reached[:3, :3].T @ truth[:3, :3]))
    return float(np.linalg.norm(reached[:3, 3] - truth[:3, 3])), float(angle)


def assert_converges(path: PoseSpline, integrator: Integrator, order: int) -> None:
    """Halving the step divides the error by 2^order, so it is the rule's and no sample's fault.

    Rotations are of second order with both rules: mean rates, or linear ones.
    """
    coarse, middle, fine = (end_error(path, rate, integrator) for rate in (250, 500, 1000))
    assert coarse[0] / middle[0] == pytest.approx(2.0**order, rel=0.05)
    assert middle[0] / fine[0] == pytest.approx(2.0**order, rel=0.05)
    assert coarse[1] / middle[1] == pytest.approx(4.0, rel=0.05)
    assert middle[1] / fine[1] == pytest.approx(4.0, rel=0.05)
    assert fine[0] < (3e-3, 3e-5)[order - 1]
    assert fine[1] < 1e-6


RULES = [(integrate_discrete, 1), (integrate_rk4, 2)]
"""The filter's integrators and their orders: the first takes the attitude from the step's start."""


@pytest.mark.parametrize(("integrator", "order"), RULES)
@pytest.mark.parametrize("make_path", [drive, walk])
def test_noiseless_samples_integrate_back_to_the_path_at_the_rule_s_order(
    make_path: Callable[[], PoseSpline], integrator: Integrator, order: int
) -> None:
    path = make_path()
    assert_converges(path, integrator, order)
    delayed = end_error(path, 500, integrator, time_offset_s=0.03)
    np.testing.assert_allclose(delayed, end_error(path, 500, integrator), rtol=1e-6)


@pytest.mark.parametrize(("integrator", "order"), RULES)
def test_samples_of_a_recorded_path_integrate_back_to_it(
    tmp_path: Path, integrator: Integrator, order: int
) -> None:
    times = ORIGIN - 10**9 + 50_000_000 * np.arange(141)  # 20 Hz
    poses = walk().pose(times)
    poses[:, :3, 3] += np.random.default_rng(2).normal(0.0, 0.002, (len(times), 3))
    write_tum(tmp_path / "walk.txt", times, poses)
    assert_converges(
        recorded_path(tmp_path / "walk.txt", ORIGIN, duration_s=5.0), integrator, order
    )


@pytest.mark.parametrize(("integrator", "order"), RULES)
def test_samples_of_a_real_recording_integrate_back_to_it(
    data_root: Path, integrator: Integrator, order: int
) -> None:
    recording = data_root / "sim_paths" / "tum_corridor1_512_16_okvis.txt"
    if not recording.exists():
        pytest.skip(f"{recording} is missing")
    path = recorded_path(recording, ORIGIN, start_s=30.0, duration_s=5.0)
    assert_converges(path, integrator, order)


def test_resting_imu_reads_gravity_only() -> None:
    R = so3.exp(np.array([0.1, 0.2, 0.3]))
    rest = standing_path(se3.make(R, np.zeros(3)), ORIGIN, 2.0)
    imu = perfect_imu(rest, ORIGIN + np.arange(10) * 10_000_000)
    np.testing.assert_allclose(imu.gyro, 0.0, atol=1e-12)
    np.testing.assert_allclose(imu.accel @ R.T, [[0.0, 0.0, GRAVITY_MPS2]] * 10, atol=1e-9)


def test_time_offset_delays_the_stamps() -> None:
    path = drive()
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
