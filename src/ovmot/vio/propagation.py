"""IMU propagation of the mean, the transition matrix and the noise, over one camera interval.

Each pair of consecutive samples is integrated in the body frame at its start (`integrators`), all
pairs at once, and the increments are chained. Gravity is (0, 0, -g) in world.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.physics import ACCEL_SIGMA_MPS2, MANOEUVRE_S, YAW_RATE_SIGMA_RPS
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import Increments, Integrator
from ovmot.vio.online_calibration import (
    OnlineCalibration,
    correct_imu,
    imu_intrinsics,
    imu_sensitivity,
)
from ovmot.vio.state import (
    ACCEL_BIAS,
    CLONE_SIZE,
    GYRO_BIAS,
    N_BASE,
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
) -> Propagation:
    """Integrate `samples` (n + 1), whose first and last stamps are the interval's ends.

    `imu`, `imu_first`: latest and first estimate at the start; `gravity` in m/s². `in_gap` (n,)
    marks the pairs that lie in a gap of the stream: what was interpolated there was not measured,
    and its noise is that of a vehicle's motion.

    Φ maps the error at the start to the end; its rotation columns are written by the estimates at
    both ends, the start taken at the first estimates (J. Hesch et al., TRO 2014), so that
    transitions of consecutive intervals agree on the unobservable directions.
    """
    dt = np.diff(samples.timestamp_ns) * 1e-9
    bias = (imu.gyro_bias, imu.accel_bias)
    gyro, accel = correct_imu(samples.gyro, samples.accel, bias, imu_intrinsics(calibration))
    increments = integrator(gyro, accel, dt)
    mean_rate, mean_accel = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    g = np.array([0.0, 0.0, -gravity])
    R = _chain_rotations(imu.R_world_imu, increments.rotation)
    F, Q = _pair_matrices(R[:-1], increments, mean_rate, mean_accel, noise, in_gap)
    by_calibration = _calibration_columns(F, samples, bias, calibration)
    v, p = imu.velocity, imu.position
    transition, covariance = np.eye(N_IMU, N_BASE + len(calibration)), np.zeros((N_IMU, N_IMU))
    for i, h in enumerate(dt):
        covariance = F[i] @ covariance @ F[i].T + Q[i]
        transition = F[i] @ transition
        transition[:, N_BASE:] += by_calibration[i]
        p = p + v * h + 0.5 * g * h * h + R[i] @ increments.position[i]
        v = v + g * h + R[i] @ increments.velocity[i]
    end = replace(imu, R_world_imu=so3.project_to_rotation(R[-1]), velocity=v, position=p)
    transition = _with_first_estimates(transition, imu_first, end, float(dt.sum()), g)
    return Propagation(end, transition, 0.5 * (covariance + covariance.T), gyro[-1])


def propagate(state: State, result: Propagation, timestamp_ns: int) -> State:
    """The state propagated to `timestamp_ns`; clones stay, their correlation goes through Φ."""
    P = state.covariance.copy()
    Phi, n = result.transition, result.transition.shape[1]
    cross = Phi @ P[:n]
    P[:N_IMU], P[:, :N_IMU] = cross, cross.T
    P[:N_IMU, :N_IMU] = cross[:, :n] @ Phi.T + result.noise
    return replace(
        state,
        timestamp_ns=timestamp_ns,
        imu=result.imu,
        imu_first=result.imu,
        covariance=0.5 * (P + P.T),
    )


def clone_pose(state: State, frame_ns: int, angular_velocity: FloatArray) -> State:
    """The state augmented by a clone of the present pose, as that of frame `frame_ns`.

    The clone's error depends on the time offset's: the pose is that of t_cam + offset, so it moves
    by (ω, v)·δoffset (M. Li & A. Mourikis, IJRR 2014). `angular_velocity` (3,): body rates, rad/s.
    """
    P, n, at = state.covariance, len(state.covariance), state.first_landmark
    by_offset = np.concatenate([angular_velocity, state.imu.velocity])
    pose = P[THETA.start : POSITION.stop] + np.outer(by_offset, P[TIME_OFFSET])
    # the new clone comes after the others, before the landmarks
    new, old = slice(at, at + CLONE_SIZE), np.r_[:at, at + CLONE_SIZE : n + CLONE_SIZE]
    covariance = np.empty((n + CLONE_SIZE, n + CLONE_SIZE))
    covariance[np.ix_(old, old)] = P
    covariance[new, old], covariance[old, new] = pose, pose.T
    covariance[new, new] = pose[:, THETA.start : POSITION.stop] + np.outer(
        pose[:, TIME_OFFSET], by_offset
    )
    T = pose_matrix(state.imu)
    clones = Clones(
        np.append(state.clones.timestamp_ns, frame_ns),
        np.concatenate([state.clones.T_world_imu, T[None]]),
        np.concatenate([state.clones.T_world_imu_first, T[None]]),
    )
    return replace(state, clones=clones, covariance=covariance)


def _chain_rotations(R_start: FloatArray, increments: FloatArray) -> FloatArray:
    """Rotations (n + 1, 3, 3) at the ends of all pairs, from n increments (n, 3, 3)."""
    out = np.empty((len(increments) + 1, 3, 3))
    out[0] = R_start
    for i, increment in enumerate(increments):
        out[i + 1] = out[i] @ increment
    return out


def _pair_matrices(
    R: FloatArray,
    increments: Increments,
    rate: FloatArray,
    accel: FloatArray,
    noise: ImuNoise,
    in_gap: BoolArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Transition F and noise Q (n, 15, 15) of each sample pair that starts at R (n, 3, 3).

    All axes have the same noise, so Q needs no rotation.
    """
    n = len(increments.dt)
    h = increments.dt[:, None, None]
    eye = np.eye(3)
    Jr = so3.right_jacobian(rate * increments.dt[:, None])
    RA = R @ so3.hat(accel)
    F = np.broadcast_to(np.eye(N_IMU), (n, N_IMU, N_IMU)).copy()
    F[:, THETA, THETA] = np.swapaxes(increments.rotation, -1, -2)
    F[:, THETA, GYRO_BIAS] = -Jr * h
    F[:, POSITION, THETA] = -R @ so3.hat(increments.position)
    F[:, POSITION, VELOCITY] = eye * h
    F[:, POSITION, GYRO_BIAS] = RA * h**3 / 6.0
    F[:, POSITION, ACCEL_BIAS] = -0.5 * R * h**2
    F[:, VELOCITY, THETA] = -R @ so3.hat(increments.velocity)
    F[:, VELOCITY, GYRO_BIAS] = 0.5 * RA * h**2
    F[:, VELOCITY, ACCEL_BIAS] = -R * h

    gap = np.zeros((n, 1, 1), np.bool_) if in_gap is None else in_gap[:, None, None]
    # where samples are missing, the motion is only known to be a vehicle's
    gyro_variance = np.where(gap, _vehicle_noise(YAW_RATE_SIGMA_RPS), noise.gyro) ** 2
    accel_variance = np.where(gap, _vehicle_noise(ACCEL_SIGMA_MPS2), noise.accel) ** 2
    Q = np.zeros((n, N_IMU, N_IMU))
    Q[:, THETA, THETA] = gyro_variance * h * Jr @ np.swapaxes(Jr, -1, -2)
    Q[:, VELOCITY, VELOCITY] = accel_variance * h * eye
    Q[:, POSITION, POSITION] = accel_variance * h**3 / 4.0 * eye
    Q[:, POSITION, VELOCITY] = Q[:, VELOCITY, POSITION] = accel_variance * h**2 / 2.0 * eye
    Q[:, GYRO_BIAS, GYRO_BIAS] = noise.gyro_walk**2 * h * eye
    Q[:, ACCEL_BIAS, ACCEL_BIAS] = noise.accel_walk**2 * h * eye
    return F, Q


def _vehicle_noise(sigma: float) -> float:
    """White noise density of a motion of standard deviation `sigma` that persists for a time τ:
    σ √(2τ) (R. Singer, IEEE TAES 1970), 3 m/s²/√Hz and 0.5 rad/s/√Hz."""
    return float(sigma * np.sqrt(2.0 * MANOEUVRE_S))


def _calibration_columns(
    F: FloatArray,
    samples: ImuData,
    bias: tuple[FloatArray, FloatArray],
    calibration: OnlineCalibration,
) -> FloatArray:
    """Columns (n, 15, C) of the calibration; in place, F's bias columns for an IMU with intrinsics.

    The derivative of a pair's motion by its mean rate and force is minus F's bias columns.
    """
    if imu_intrinsics(calibration) is None:
        return np.zeros((len(F), N_IMU, len(calibration)))
    rate, force = (0.5 * (x[:-1] + x[1:]) for x in (samples.gyro, samples.accel))
    by_rate, by_force = imu_sensitivity(rate, force, bias, calibration)
    motion = slice(THETA.start, VELOCITY.stop)
    F_rate, F_force = -F[:, motion, GYRO_BIAS], -F[:, motion, ACCEL_BIAS]
    columns = F_rate @ by_rate + F_force @ by_force
    F[:, motion, GYRO_BIAS.start : ACCEL_BIAS.stop] = columns[..., :6]
    out = np.zeros((len(F), N_IMU, len(calibration)))
    out[:, motion] = columns[..., 6:]
    return out


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
