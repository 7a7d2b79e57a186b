"""IMU samples of a trajectory: exact ones, and those of a real sensor with noise and biases."""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.simulation import ImuModel
from ovmot.types import ImuData, ImuNoise

GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, slots=True)
class SimulatedImu:
    """Samples, and the true biases (N, 3) that are in them, rad/s and m/s²."""

    data: ImuData
    gyro_bias: FloatArray
    accel_bias: FloatArray


def perfect_imu(
    path: PoseSpline,
    timestamp_ns: IntArray,
    *,
    time_offset_s: float = 0.0,
    gravity_mps2: float = GRAVITY_MPS2,
) -> ImuData:
    """What an ideal IMU on T_world_imu(t) reads at its own stamps (N,).

    The path is in the camera's time, and t_imu = t_cam + `time_offset_s`. The specific force is
    R_imu_world (a - g) with g along -z of the world. Raises `ValueError` outside the path.
    """
    stamps = np.asarray(timestamp_ns, dtype=np.int64)
    times = stamps - round(1e9 * time_offset_s)
    force_world = path.acceleration(times) + np.array([0.0, 0.0, gravity_mps2])
    R_world_imu = path.pose(times)[:, :3, :3]
    accel = (np.swapaxes(R_world_imu, -1, -2) @ force_world[..., None])[..., 0]
    return ImuData(stamps, path.angular_velocity(times), accel)


def noisy_imu(
    perfect: ImuData,
    noise: ImuNoise,
    rng: np.random.Generator,
    *,
    gyro_bias: FloatArray,
    accel_bias: FloatArray,
) -> SimulatedImu:
    """Adds biases, (3,) each at the first sample, that walk, and white noise.

    Discrete forms of the densities over the samples' interval: white σ/√dt, walk σ√dt
    (J. Crassidis, "Sigma-point Kalman filtering for integrated GPS and inertial navigation", 2006).
    """
    dt = 1e-9 * np.median(np.diff(perfect.timestamp_ns)) if len(perfect) > 1 else 1.0
    gyro_walk = gyro_bias + _walk(noise.gyro_walk * np.sqrt(dt), len(perfect), rng)
    accel_walk = accel_bias + _walk(noise.accel_walk * np.sqrt(dt), len(perfect), rng)
    shape = (len(perfect), 3)
    gyro = perfect.gyro + gyro_walk + rng.normal(0.0, noise.gyro / np.sqrt(dt), shape)
    accel = perfect.accel + accel_walk + rng.normal(0.0, noise.accel / np.sqrt(dt), shape)
    return SimulatedImu(ImuData(perfect.timestamp_ns, gyro, accel), gyro_walk, accel_walk)


def simulated_imu(
    path: PoseSpline,
    timestamp_ns: IntArray,
    model: ImuModel,
    rng: np.random.Generator,
    *,
    time_offset_s: float = 0.0,
) -> SimulatedImu:
    """What a real IMU of this model gives at its own stamps (N,), fewer where samples are lost.

    The exact readings get the systematic errors, then bias and noise; then they are cut to the
    sensors' ranges, and samples are dropped (see `ImuErrors` for the equations).
    """
    perfect = perfect_imu(path, timestamp_ns, time_offset_s=time_offset_s)
    noisy = noisy_imu(
        model.errors.distorted(perfect), model.noise, rng,
        gyro_bias=model.gyro_bias, accel_bias=model.accel_bias,
    )  # fmt: skip
    cut = model.errors.saturated(noisy.data)
    keep = model.errors.kept(cut.timestamp_ns, rng)
    data = ImuData(cut.timestamp_ns[keep], cut.gyro[keep], cut.accel[keep])
    return SimulatedImu(data, noisy.gyro_bias[keep], noisy.accel_bias[keep])


def _walk(step_sigma: float, count: int, rng: np.random.Generator) -> FloatArray:
    """A random walk (count, 3) that starts at zero."""
    steps = rng.normal(0.0, step_sigma, (count, 3))
    steps[:1] = 0.0
    return np.asarray(np.cumsum(steps, axis=0))
