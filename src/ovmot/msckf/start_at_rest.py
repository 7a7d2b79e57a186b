"""Start at rest: a resting IMU gives tilt and gyro bias; no jerk is needed."""

from dataclasses import dataclass

import numpy as np

from ovmot.config import InitializationSettings
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.msckf.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    N_BASE,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    ImuState,
    State,
    no_clones,
)
from ovmot.msckf.update import ekf_update
from ovmot.types import ImuData, ImuNoise

GAUGE_SIGMA = 1e-5  # yaw and position are zero by definition
_TILT_SIGMA = 0.1  # rad, before gravity is used
_REST_SPEED_SIGMA = 0.02  # m/s


@dataclass(frozen=True, slots=True)
class StartPrior:
    """What a start knows beforehand: gravity in m/s², the time offset and its standard deviation
    in seconds, and the standard deviation of the accelerometer bias in m/s²."""

    gravity: float
    time_offset_s: float
    time_offset_sigma_s: float
    accel_bias_sigma: float


def rest_failure(imu: ImuData, still_share: float, settings: InitializationSettings) -> str | None:
    """Why the rig can not be said to rest, or None if it can."""
    gyro, accel = float(imu.gyro.std(0).max()), float(imu.accel.std(0).max())
    if gyro > settings.rest_gyro_rps:
        return f"gyroscope varies by {gyro:.3f} rad/s (at rest below {settings.rest_gyro_rps:g})"
    if accel > settings.rest_accel_mps2:
        return (
            f"accelerometer varies by {accel:.3f} m/s² (at rest below {settings.rest_accel_mps2:g})"
        )
    if still_share < settings.rest_share:
        return (
            f"only {100 * still_share:.0f} % of the points stand still"
            f" (at rest at least {100 * settings.rest_share:.0f} %)"
        )
    return None


def start_at_rest(imu: ImuData, noise: ImuNoise, prior: StartPrior) -> State:
    """The state at the last sample of a resting IMU, with yaw and position zero.

    The mean specific force levels the
    rig and, as a measurement a = Rᵀ(0, 0, g) + b_a, ties tilt and accelerometer bias together.
    """
    force, rate = imu.accel.mean(0), imu.gyro.mean(0)
    span = float((imu.timestamp_ns[-1] - imu.timestamp_ns[0]) * 1e-9)
    R_world_imu = _level(force)
    zero = np.zeros(3)
    state = ImuState(R_world_imu, zero, zero, rate, zero)
    up_body = R_world_imu.T @ np.array([0.0, 0.0, 1.0])
    P = np.zeros((N_BASE, N_BASE))
    tilt = np.eye(3) - np.outer(up_body, up_body)
    P[THETA, THETA] = _TILT_SIGMA**2 * tilt + GAUGE_SIGMA**2 * np.outer(up_body, up_body)
    P[POSITION, POSITION] = GAUGE_SIGMA**2 * np.eye(3)
    P[VELOCITY, VELOCITY] = _REST_SPEED_SIGMA**2 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] = (noise.gyro**2 / span + noise.gyro_walk**2 * span + 1e-10) * np.eye(3)
    P[ACCEL_BIAS, ACCEL_BIAS] = prior.accel_bias_sigma**2 * np.eye(3)
    P[TIME_OFFSET, TIME_OFFSET] = prior.time_offset_sigma_s**2
    start = State(int(imu.timestamp_ns[-1]), state, state, prior.time_offset_s, no_clones(), P)
    levelled = ekf_update(
        start, *_gravity_measurement(start, force, prior.gravity, noise.accel**2 / span)
    )
    return State(
        levelled.timestamp_ns, levelled.imu, levelled.imu, levelled.time_offset_s,
        levelled.clones, levelled.covariance,
    )  # fmt: skip


def _level(force: FloatArray) -> FloatArray:
    """Rotation body to world that turns the specific force to +z, with zero yaw of the x axis."""
    R = so3.between_vectors(force, np.array([0.0, 0.0, 1.0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    return so3.exp(np.array([0.0, 0.0, -yaw])) @ R


def _gravity_measurement(
    state: State, force: FloatArray, gravity: float, variance: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """H, columns, residual, variance of a = Rᵀ g_up + b_a; ∂(Rᵀ u)/∂θ = [Rᵀ u]x."""
    up = state.imu.R_world_imu.T @ np.array([0.0, 0.0, gravity])
    H = np.concatenate([so3.hat(up), np.eye(3)], axis=1)
    columns = np.r_[np.arange(0, 3), np.arange(12, 15)]
    residual = force - up - state.imu.accel_bias
    return H, columns, residual, np.full(3, variance + 1e-6)
