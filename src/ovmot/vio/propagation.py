"""IMU propagation of the mean, the transition matrix and the noise, over one camera interval.

Each pair of consecutive samples is integrated from identity in its own frame, all pairs at once
(ΔR, Δv, Δp; C. Forster et al., TRO 2017), and the increments are chained. Gravity is (0, 0, -g).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.online_calibration import Calibration, correct_imu, imu_intrinsics, imu_sensitivity
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

# Where samples are missing, nothing was measured: the motion is only known to be a vehicle's.
_FIXED = Calibration()
_GAP_GYRO = 0.5  # rad/s/sqrt(Hz)
_GAP_ACCEL = 3.0  # m/s²/sqrt(Hz)


@dataclass(frozen=True, slots=True)
class Increments:
    """Motion over each of n sample pairs, in the body frame at its start, and its length.

    `rotation` (n, 3, 3), `velocity` (n, 3), `position` (n, 3), gravity not included; `dt` (n,).
    """

    rotation: FloatArray
    velocity: FloatArray
    position: FloatArray
    dt: FloatArray


Integrator = Callable[[FloatArray, FloatArray, FloatArray], Increments]


def integrate_discrete(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Constant mean rates over each pair: gyro, accel (n + 1, 3) without bias, dt (n,)."""
    w, a = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    step = dt[:, None]
    return Increments(so3.exp(w * step), a * step, 0.5 * a * step**2, dt)


def integrate_rk4(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Runge-Kutta of 4th order with rates linear over each pair; arguments as above."""
    h = dt[:, None]
    w0, w1, a0, a1 = gyro[:-1], gyro[1:], accel[:-1], accel[1:]
    wm, am = 0.5 * (w0 + w1), 0.5 * (a0 + a1)

    # The rotation vector's rate is J_r^-1(φ) ω: one RK4 step on φ from zero.
    def rate(phi: FloatArray, w: FloatArray) -> FloatArray:
        return (so3.right_jacobian_inverse(phi) @ w[..., None])[..., 0]

    k1 = w0
    k2 = rate(0.5 * h * k1, wm)
    k3 = rate(0.5 * h * k2, wm)
    k4 = rate(h * k3, w1)
    phi = h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    R_mid, R_end = so3.exp(0.5 * h * k2), so3.exp(phi)
    # v' = R a and p' = v: with a(t) known, RK4 is Simpson's rule.
    f0, fm, f1 = a0, (R_mid @ am[..., None])[..., 0], (R_end @ a1[..., None])[..., 0]
    return Increments(
        R_end, h / 6.0 * (f0 + 4.0 * fm + f1), h**2 / 6.0 * (f0 + 2.0 * fm), dt
    )  # fmt: skip


def integrate_analytic(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Closed form for mean rates that are constant in the body frame over each pair.

    ∫exp(ωt)dt = J_l(ωh) h, and the integral of that in closed form (Y. Yang et al., TRO 2023).
    """
    h = dt[:, None]
    w, a = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    phi = w * h
    once = so3.left_jacobian(phi)
    twice = so3.second_left_jacobian(phi)
    velocity = h * (once @ a[..., None])[..., 0]
    position = h**2 * (twice @ a[..., None])[..., 0]
    return Increments(so3.exp(phi), velocity, position, dt)


INTEGRATORS: dict[str, Integrator] = {
    "discrete": integrate_discrete,
    "rk4": integrate_rk4,
    "analytic": integrate_analytic,
}


@dataclass(frozen=True, slots=True)
class Propagation:
    """Result of one interval: the IMU state at its end, Φ (15, 16 + C) and Q (15, 15).

    Φ's columns are the IMU's, the time offset's (zero) and the calibration's.
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
    unseen: BoolArray | None = None,
    calibration: Calibration = _FIXED,
) -> Propagation:
    """Integrate `samples` (n + 1), whose first and last stamps are the interval's ends.

    `unseen` (n,) marks the pairs that lie in a hole of the stream: what was interpolated there was
    not measured, and its noise is that of a vehicle's motion.

    Φ maps the error at the start to the end; its motion blocks are written by the positions at
    both ends, the start taken at the first estimates (J. Hesch et al., TRO 2014), so that
    transitions of consecutive intervals agree on what can not be observed.
    """
    dt = np.diff(samples.timestamp_ns) * 1e-9
    bias = (imu.gyro_bias, imu.accel_bias)
    gyro, accel = correct_imu(samples.gyro, samples.accel, bias, imu_intrinsics(calibration))
    parts = integrator(gyro, accel, dt)
    mean_rate, mean_accel = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    g = np.array([0.0, 0.0, -gravity])
    R = _chain(imu.R_world_imu, parts.rotation)
    F, Q = _interval_matrices(R[:-1], parts, mean_rate, mean_accel, noise, unseen)
    by_calibration = _calibrated(F, samples, bias, calibration)
    v, p = imu.velocity, imu.position
    transition, covariance = np.eye(N_IMU, N_BASE + len(calibration)), np.zeros((N_IMU, N_IMU))
    for i, h in enumerate(dt):
        covariance = F[i] @ covariance @ F[i].T + Q[i]
        transition = F[i] @ transition
        transition[:, N_BASE:] += by_calibration[i]
        p = p + v * h + 0.5 * g * h * h + R[i] @ parts.position[i]
        v = v + g * h + R[i] @ parts.velocity[i]
    end = replace(imu, R_world_imu=so3.project_to_rotation(R[-1]), velocity=v, position=p)
    transition = _with_first_estimates(transition, imu_first, end, float(dt.sum()), g)
    return Propagation(end, transition, 0.5 * (covariance + covariance.T), gyro[-1])


def propagate(state: State, result: Propagation, timestamp_ns: int) -> State:
    """The state carried to `timestamp_ns` by a propagation; clones stay, correlated through Φ."""
    P = state.covariance.copy()
    Phi, n = result.transition, result.transition.shape[1]
    moved = Phi @ P[:n]
    P[:N_IMU], P[:, :N_IMU] = moved, moved.T
    P[:N_IMU, :N_IMU] = moved[:, :n] @ Phi.T + result.noise
    return replace(
        state,
        timestamp_ns=timestamp_ns,
        imu=result.imu,
        imu_first=result.imu,
        covariance=0.5 * (P + P.T),
    )


def clone_pose(state: State, frame_ns: int, angular_velocity: FloatArray) -> State:
    """The state with the present pose cloned as that of frame `frame_ns`.

    The clone's error holds the time offset's: the pose is that of t_cam + offset, so it moves by
    (ω, v)·δoffset (M. Li & A. Mourikis, IJRR 2014). `angular_velocity` (3,): body rates, rad/s.
    """
    P, n, at = state.covariance, len(state.covariance), state.first_landmark
    by_offset = np.concatenate([angular_velocity, state.imu.velocity])
    pose = P[THETA.start : POSITION.stop] + np.outer(by_offset, P[TIME_OFFSET])
    # the clone comes after the others, before the landmarks
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


def _chain(R_start: FloatArray, steps: FloatArray) -> FloatArray:
    """Rotations (n + 1, 3, 3) from the start on, one more after each of n steps (n, 3, 3)."""
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = R_start
    for i, step in enumerate(steps):
        out[i + 1] = out[i] @ step
    return out


def _interval_matrices(
    R: FloatArray,
    parts: Increments,
    rate: FloatArray,
    accel: FloatArray,
    noise: ImuNoise,
    unseen: BoolArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Transition and noise (n, 15, 15) of each sample pair that starts at rotation R (n, 3, 3).

    The noise of an axis is that of every other, so Q needs no rotation.
    """
    n = len(parts.dt)
    h = parts.dt[:, None, None]
    eye = np.eye(3)
    Jr = so3.right_jacobian(rate * parts.dt[:, None])
    RA = R @ so3.hat(accel)
    F = np.broadcast_to(np.eye(N_IMU), (n, N_IMU, N_IMU)).copy()
    F[:, THETA, THETA] = np.swapaxes(parts.rotation, -1, -2)
    F[:, THETA, GYRO_BIAS] = -Jr * h
    F[:, POSITION, THETA] = -R @ so3.hat(parts.position)
    F[:, POSITION, VELOCITY] = eye * h
    F[:, POSITION, GYRO_BIAS] = RA * h**3 / 6.0
    F[:, POSITION, ACCEL_BIAS] = -0.5 * R * h**2
    F[:, VELOCITY, THETA] = -R @ so3.hat(parts.velocity)
    F[:, VELOCITY, GYRO_BIAS] = 0.5 * RA * h**2
    F[:, VELOCITY, ACCEL_BIAS] = -R * h

    gap = np.zeros((n, 1, 1), np.bool_) if unseen is None else unseen[:, None, None]
    gyro_variance = np.where(gap, _GAP_GYRO, noise.gyro) ** 2
    accel_variance = np.where(gap, _GAP_ACCEL, noise.accel) ** 2
    Q = np.zeros((n, N_IMU, N_IMU))
    Q[:, THETA, THETA] = gyro_variance * h * Jr @ np.swapaxes(Jr, -1, -2)
    Q[:, VELOCITY, VELOCITY] = accel_variance * h * eye
    Q[:, POSITION, POSITION] = accel_variance * h**3 / 4.0 * eye
    Q[:, POSITION, VELOCITY] = Q[:, VELOCITY, POSITION] = accel_variance * h**2 / 2.0 * eye
    Q[:, GYRO_BIAS, GYRO_BIAS] = noise.gyro_walk**2 * h * eye
    Q[:, ACCEL_BIAS, ACCEL_BIAS] = noise.accel_walk**2 * h * eye
    return F, Q


def _calibrated(
    F: FloatArray, samples: ImuData, bias: tuple[FloatArray, FloatArray], calibration: Calibration
) -> FloatArray:
    """Columns (n, 15, C) of the calibration; in place, F's bias columns for an IMU with intrinsics.

    Each pair's motion depends on its mean rate and force, which F holds as minus its bias columns.
    """
    if imu_intrinsics(calibration) is None:
        return np.zeros((len(F), N_IMU, len(calibration)))
    rate, force = (0.5 * (x[:-1] + x[1:]) for x in (samples.gyro, samples.accel))
    by_rate, by_force = imu_sensitivity(rate, force, bias, calibration)
    moving = slice(THETA.start, VELOCITY.stop)
    F_rate, F_force = -F[:, moving, GYRO_BIAS], -F[:, moving, ACCEL_BIAS]
    columns = F_rate @ by_rate + F_force @ by_force
    F[:, moving, GYRO_BIAS.start : ACCEL_BIAS.stop] = columns[..., :6]
    out = np.zeros((len(F), N_IMU, len(calibration)))
    out[:, moving] = columns[..., 6:]
    return out


def _with_first_estimates(
    transition: FloatArray, first: ImuState, end: ImuState, span: float, g: FloatArray
) -> FloatArray:
    """Φ with its rotation columns written by first estimates at the start."""
    out = transition.copy()
    R0 = first.R_world_imu
    out[THETA, THETA] = end.R_world_imu.T @ R0
    moved = end.position - first.position - first.velocity * span - 0.5 * g * span**2
    out[POSITION, THETA] = -so3.hat(moved) @ R0
    out[VELOCITY, THETA] = -so3.hat(end.velocity - first.velocity - g * span) @ R0
    return out
