"""IMU propagation of the mean, the transition matrix and the noise, over one camera interval.

Each pair of consecutive samples is integrated in the body frame at its start (`integrators`), all
pairs at once, and the increments are chained. Gravity is (0, 0, -g) in world.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.physics import ACCEL_SIGMA_MPS2, MANOEUVRE_S, YAW_RATE_SIGMA_RPS
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import Integrator
from ovmot.vio.online_calibration import (
    OnlineCalibration,
    correct_imu,
    imu_intrinsics,
    imu_sensitivity,
)
from ovmot.vio.propagation_kernel import (
    chain_pairs_compiled,
    chain_poses_compiled,
    clone_covariance_compiled,
    propagate_covariance_compiled,
)
from ovmot.vio.state import (
    N_IMU,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    Clones,
    ImuState,
    State,
    pose_matrix,
)

_NO_CALIBRATION = OnlineCalibration()


@dataclass(frozen=True, slots=True)
class Propagation:
    """Result of one interval: the IMU state at its end, Φ (15, 16 + C) and Q (15, 15).

    Φ's columns are the IMU's, the time offset's (zero) and the calibration's. `angular_velocity`
    (3,): body rates at the end, rad/s.
    """

    imu: ImuState
    transition: FloatArray
    noise: FloatArray
    angular_velocity: FloatArray


def propagate_imu(
    imu: ImuState,
    imu_first: ImuState,
    samples: ImuData,
    noise: ImuNoise,
    gravity: float,
    integrator: Integrator,
    in_gap: BoolArray | None = None,
    calibration: OnlineCalibration = _NO_CALIBRATION,
    unsure_s: float = 0.0,
) -> Propagation:
    """Integrate `samples` (n + 1), whose first and last stamps are the interval's ends.

    `imu`, `imu_first`: latest and first estimate at the start; `gravity` in m/s². `in_gap` (n,)
    marks the pairs that lie in a gap of the stream: what was interpolated there was not measured,
    and its noise is that of a vehicle's motion. `unsure_s`: standard deviation of the interval's
    length, where the clock may have been set.

    Φ maps the error at the start to the end; its rotation columns are written by the estimates at
    both ends, the start taken at the first estimates (J. Hesch et al., TRO 2014), so that
    transitions of consecutive intervals agree on the unobservable directions.
    """
    dt = np.diff(samples.timestamp_ns) * 1e-9
    bias = (imu.gyro_bias, imu.accel_bias)
    gyro, accel = correct_imu(samples.gyro, samples.accel, bias, imu_intrinsics(calibration))
    increments = integrator(gyro, accel, dt)
    by_rate, by_force = imu_sensitivity(
        _means(samples.gyro), _means(samples.accel), bias, calibration
    )
    T, velocity, transition, covariance = chain_pairs_compiled(
        pose_matrix(imu), imu.velocity, gravity, increments.rotation, increments.velocity,
        increments.position, dt, _means(gyro), _means(accel), by_rate, by_force,
        _white_noise(noise, in_gap, len(dt)), np.array([noise.gyro_walk, noise.accel_walk]) ** 2,
    )  # fmt: skip
    end = ImuState(T[:3, :3].copy(), T[:3, 3].copy(), velocity, imu.gyro_bias, imu.accel_bias)
    g = np.array([0.0, 0.0, -gravity])
    transition = _with_first_estimates(transition, imu_first, end, float(dt.sum()), g)
    if unsure_s > 0.0:
        covariance = covariance + _length_noise(gyro.mean(axis=0), imu.velocity, unsure_s)
    return Propagation(end, transition, covariance, gyro[-1])


def predicted_poses(
    imu: ImuState, samples: ImuData, gravity: float, calibration: OnlineCalibration
) -> FloatArray:
    """Poses T_world_imu (n + 1, 4, 4) at the samples (n + 1), from the state at the first one."""
    bias = (imu.gyro_bias, imu.accel_bias)
    gyro, accel = correct_imu(samples.gyro, samples.accel, bias, imu_intrinsics(calibration))
    dt = np.diff(samples.timestamp_ns) * 1e-9
    poses: FloatArray = chain_poses_compiled(
        pose_matrix(imu), imu.velocity, gravity,
        np.ascontiguousarray(gyro), np.ascontiguousarray(accel), dt,
    )  # fmt: skip
    return poses


def propagate(state: State, result: Propagation, timestamp_ns: int) -> State:
    """The state propagated to `timestamp_ns`; clones stay, their correlation goes through Φ."""
    covariance = propagate_covariance_compiled(state.covariance, result.transition, result.noise)
    return State(
        timestamp_ns, result.imu, result.imu, state.time_offset_s, state.clones, covariance,
        state.calibration, state.landmarks,
    )  # fmt: skip


def clone_pose(state: State, frame_ns: int, angular_velocity: FloatArray) -> State:
    """The state augmented by a clone of the present pose, as that of frame `frame_ns`.

    The clone's error depends on the time offset's: the pose is that of t_cam + offset, so it moves
    by (ω, v)·δoffset (M. Li & A. Mourikis, IJRR 2014). `angular_velocity` (3,): body rates, rad/s.
    """
    by_offset = np.concatenate([angular_velocity, state.imu.velocity])
    # the new clone comes after the others, before the landmarks
    covariance = clone_covariance_compiled(
        state.covariance, by_offset, state.first_landmark, TIME_OFFSET
    )
    T = pose_matrix(state.imu)
    clones = Clones(
        np.concatenate([state.clones.timestamp_ns, [frame_ns]]),
        np.concatenate([state.clones.T_world_imu, T[None]]),
        np.concatenate([state.clones.T_world_imu_first, T[None]]),
    )
    return State(
        state.timestamp_ns, state.imu, state.imu_first, state.time_offset_s, clones, covariance,
        state.calibration, state.landmarks,
    )  # fmt: skip


def _means(values: FloatArray) -> FloatArray:
    """Means (n, 3) of consecutive samples (n + 1, 3)."""
    return np.asarray(0.5 * (values[:-1] + values[1:]))


def _white_noise(noise: ImuNoise, in_gap: BoolArray | None, n: int) -> FloatArray:
    """Squared densities (n, 2) of the noise of gyroscope and accelerometer in n pairs.

    Where samples are missing, the motion is only known to be a vehicle's.
    """
    out = np.empty((n, 2))
    out[:, 0], out[:, 1] = noise.gyro**2, noise.accel**2
    if in_gap is not None and in_gap.any():
        out[in_gap] = _vehicle_noise(YAW_RATE_SIGMA_RPS) ** 2, _vehicle_noise(ACCEL_SIGMA_MPS2) ** 2
    return out


def _length_noise(angular_velocity: FloatArray, velocity: FloatArray, sigma_s: float) -> FloatArray:
    """Covariance (15, 15) by an interval whose length has a standard deviation of `sigma_s`: the
    pose moves by (ω, v) times the length's error. `angular_velocity` (3,) in the body, rad/s."""
    moved = np.zeros(N_IMU)
    moved[THETA], moved[POSITION] = sigma_s * angular_velocity, sigma_s * velocity
    return np.outer(moved, moved)


def _vehicle_noise(sigma: float) -> float:
    """White noise density of a motion of standard deviation `sigma` that persists for a time τ:
    σ √(2τ) (R. Singer, IEEE TAES 1970), 3 m/s²/√Hz and 0.5 rad/s/√Hz."""
    return float(sigma * np.sqrt(2.0 * MANOEUVRE_S))


def _with_first_estimates(
    transition: FloatArray, first: ImuState, end: ImuState, span: float, g: FloatArray
) -> FloatArray:
    """Φ with its rotation columns written by the first estimates at the start (FEJ)."""
    out = transition.copy()
    R0 = first.R_world_imu
    out[THETA, THETA] = end.R_world_imu.T @ R0
    displacement = end.position - first.position - first.velocity * span - 0.5 * g * span**2
    out[POSITION, THETA] = -so3.hat(displacement) @ R0
    out[VELOCITY, THETA] = -so3.hat(end.velocity - first.velocity - g * span) @ R0
    return out
