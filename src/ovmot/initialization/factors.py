"""Factors of the initializer's bundle adjustment beside the images: IMU, zero velocity, priors.

Each gives whitened residuals r and their Jacobian J by the window's error coordinates, so that the
Gauss-Newton step solves JᵀJ δ = -Jᵀr. IMU factors follow C. Forster et al., "On-manifold
preintegration", TRO 2017: one integration for each interval between keyframes, in the body frame at
its start and without gravity, by the filter's own propagation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.initialization.window import (
    BIAS_OF_ACCEL,
    BIAS_OF_GYRO,
    KEYFRAME_SIZE,
    OFFSET,
    KeyframeWindow,
)
from ovmot.physics import GYRO_BIAS_SIGMA_RPS
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import Integrator
from ovmot.vio.propagation import Propagation, propagate_imu
from ovmot.vio.state import GYRO_BIAS, POSITION, THETA, VELOCITY, ImuState

GAUGE_SIGMA = 1e-5  # m and rad: origin and heading of the world are defined, not measured
_INTEGRATION_SIGMA = 1e-6  # rad, m, m/s: keeps Q of a single sample pair from being singular

Factor = tuple[FloatArray, FloatArray]
"""Whitened residual (m,) and its Jacobian (m, N) by the window's error coordinates."""


_REST_SIGMAS = (5e-3, 1e-5, 5e-4)
"""Of a window that images and IMU both call stationary: speed, m/s; rotation, rad, and translation,
m, between two keyframes. Tighter than a single frame of the filter's zero-velocity update."""


@dataclass(frozen=True, slots=True)
class ImuIntervals:
    """The samples of the K - 1 intervals between neighbouring keyframes, and how to integrate them.

    `in_gap`: for each interval the sample pairs (n,) that lie in a gap of the stream.
    """

    samples: Sequence[ImuData]
    in_gap: Sequence[BoolArray]
    noise: ImuNoise
    integrator: Integrator


def preintegrate(window: KeyframeWindow, intervals: ImuIntervals) -> list[Propagation]:
    """ΔR, Δv, Δp of each interval with noise and Jacobians, at the window's biases."""
    zero = np.zeros(3)
    body = ImuState(np.eye(3), zero, zero, window.gyro_bias, window.accel_bias)
    return [
        propagate_imu(
            body,
            body,
            samples,
            intervals.noise,
            0.0,
            intervals.integrator,
            in_gap,
            window.calibration,
        )
        for samples, in_gap in zip(intervals.samples, intervals.in_gap, strict=True)
    ]


def imu_factor(window: KeyframeWindow, intervals: ImuIntervals, gravity: float) -> Factor:
    """9 rows for each interval: rotation, position and velocity, in the body frame at its start.

    `gravity`: its magnitude, m/s².
    """
    preintegrated = preintegrate(window, intervals)
    n, m, N = len(preintegrated), KEYFRAME_SIZE, window.size
    r, J = np.empty((n, m)), np.zeros((n, m, N))
    for i, motion in enumerate(preintegrated):
        span_s = float(window.imu_ns[i + 1] - window.imu_ns[i]) * 1e-9
        r[i], J[i] = _interval_factor(window, i, motion, span_s, gravity)
        L = np.linalg.cholesky(motion.noise[:m, :m] + _INTEGRATION_SIGMA**2 * np.eye(m))
        r[i] = solve_triangular(L, r[i], lower=True)
        J[i] = solve_triangular(L, J[i], lower=True)
    return r.ravel(), J.reshape(n * m, N)


def _interval_factor(
    window: KeyframeWindow, i: int, motion: Propagation, span_s: float, gravity: float
) -> Factor:
    """Residual (9,) and Jacobian (9, N) of one interval, not whitened; TRO 2017, eq. 45."""
    T, v = window.T_world_imu, window.velocity
    R_i, R_j = T[i, :3, :3], T[i + 1, :3, :3]
    g = np.array([0.0, 0.0, -gravity])
    delta_p = R_i.T @ (T[i + 1, :3, 3] - T[i, :3, 3] - v[i] * span_s - 0.5 * g * span_s**2)
    delta_v = R_i.T @ (v[i + 1] - v[i] - g * span_s)
    R_error = motion.imu.R_world_imu.T @ R_i.T @ R_j
    theta = so3.log(R_error)
    r = np.concatenate([theta, delta_p - motion.imu.position, delta_v - motion.imu.velocity])
    J = np.zeros((KEYFRAME_SIZE, window.size))
    start, end = J[:, window.columns(i)], J[:, window.columns(i + 1)]
    J_theta = so3.right_jacobian_inverse(theta)
    start[THETA, THETA], end[THETA, THETA] = -J_theta @ R_j.T @ R_i, J_theta
    start[POSITION, THETA], start[VELOCITY, THETA] = so3.hat(delta_p), so3.hat(delta_v)
    start[POSITION, POSITION], end[POSITION, POSITION] = -R_i.T, R_i.T
    start[POSITION, VELOCITY] = -span_s * R_i.T
    start[VELOCITY, VELOCITY], end[VELOCITY, VELOCITY] = -R_i.T, R_i.T
    by_common = motion.transition[:KEYFRAME_SIZE, GYRO_BIAS.start :]
    J[:, : window.n_common] = -by_common
    J[THETA, : window.n_common] = -J_theta @ R_error.T @ by_common[THETA]
    return r, J


def zero_velocity_factor(window: KeyframeWindow) -> Factor:
    """9 rows for each keyframe of a stationary rig: zero velocity, the pose of the one before.

    Its standard deviations are those of a window that is stationary from end to end.
    """
    T, n = window.T_world_imu, len(window)
    velocity_sigma, *pose_sigmas = _REST_SIGMAS
    sigma = np.repeat(pose_sigmas, 3)
    r, J = np.zeros((n, KEYFRAME_SIZE)), np.zeros((n, KEYFRAME_SIZE, window.size))
    for k in range(n):
        now = J[k, :, window.columns(k)]
        r[k, VELOCITY] = window.velocity[k] / velocity_sigma
        now[VELOCITY, VELOCITY] = np.eye(3) / velocity_sigma
        if k == 0:
            continue
        before = J[k, :, window.columns(k - 1)]
        theta = so3.log(T[k - 1, :3, :3].T @ T[k, :3, :3])
        r[k, :6] = np.concatenate([theta, T[k, :3, 3] - T[k - 1, :3, 3]]) / sigma
        now[THETA, THETA] = so3.right_jacobian_inverse(theta) / sigma[0]
        before[THETA, THETA] = -so3.right_jacobian_inverse(-theta) / sigma[0]
        now[POSITION, POSITION] = np.eye(3) / sigma[3]
        before[POSITION, POSITION] = -np.eye(3) / sigma[3]
    return r.ravel(), J.reshape(-1, window.size)


def prior_factor(
    window: KeyframeWindow, accel_bias_sigma: float, offset_sigma_s: float, calibration: FloatArray
) -> Factor:
    """Priors: gauge (position and heading of the first keyframe), biases, time offset, calibration.

    `accel_bias_sigma` in m/s², `offset_sigma_s` in s; `calibration` (C,): variances. The heading
    has no residual: it defines the world's. Coordinates without variance are held fixed by the
    caller; their rows have no effect.
    """
    up_body = window.T_world_imu[0, 2, :3]
    n, eye = window.n_common, np.eye(3)
    variance = np.concatenate([[offset_sigma_s**2], calibration])
    deviation = np.concatenate([[window.offset_s], window.calibration.deviation])
    weight = 1.0 / np.sqrt(np.where(variance > 0.0, variance, 1.0))
    r, J = np.zeros(10 + len(variance)), np.zeros((10 + len(variance), window.size))
    first = window.columns(0).start
    r[:3] = window.T_world_imu[0, :3, 3] / GAUGE_SIGMA
    J[:3, first + 3 : first + 6] = eye / GAUGE_SIGMA
    J[3, first : first + 3] = up_body / GAUGE_SIGMA
    r[4:7], J[4:7, BIAS_OF_GYRO] = window.gyro_bias / GYRO_BIAS_SIGMA_RPS, eye / GYRO_BIAS_SIGMA_RPS
    r[7:10], J[7:10, BIAS_OF_ACCEL] = window.accel_bias / accel_bias_sigma, eye / accel_bias_sigma
    r[10:], J[10:, OFFSET:n] = deviation * weight, np.diag(weight)
    return r, J
