"""The compiled Kalman filter of a body: both motion models predicted and updated in one call.

State (7,): position x, y, z; velocity x, y, z; yaw rate about the vertical; in world, SI.
tests/objects/test_filter_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import factor, solve_lower

N_STATE = 7
_ZERO_YAW_RATE = 1e-6
"""Variance of a yaw rate that is zero, rad²/s²: regular, at least."""


class Models(NamedTuple):
    """States (7,) and covariances (7, 7) of a body that goes straight on, and of one that turns."""

    straight: FloatArray
    straight_cov: FloatArray
    turning: FloatArray
    turning_cov: FloatArray


def predict_models(
    models: Models, dt: float, accel: float, lift: float, yaw_accel: float
) -> Models:
    """Both models predicted over dt seconds; noise densities as `Agility` has them."""
    n = N_STATE
    out = Models(np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, n)))
    F, FP, Q = np.empty((n, n)), np.empty((n, n)), np.zeros((n, n))
    process_noise(dt, accel, lift, yaw_accel, Q)
    for turns in range(2):
        if turns == 0:
            state, P, moved, predicted = (
                models.straight, models.straight_cov, out.straight, out.straight_cov
            )  # fmt: skip
            straight_step(state, dt, moved, F)
        else:
            state, P, moved, predicted = (
                models.turning, models.turning_cov, out.turning, out.turning_cov
            )  # fmt: skip
            turning_step(state, dt, moved, F)
        for a in range(n):
            for b in range(n):
                FP[a, b] = 0.0
                for c in range(n):
                    FP[a, b] += F[a, c] * P[c, b]
        for a in range(n):
            for b in range(a + 1):
                total = Q[a, b]
                for c in range(n):
                    total += FP[a, c] * F[b, c]
                predicted[a, b] = predicted[b, a] = total
    out.straight_cov[n - 1, n - 1] += _ZERO_YAW_RATE - Q[n - 1, n - 1]
    return out


@part
def straight_step(state: FloatArray, dt: float, moved: FloatArray, F: FloatArray) -> None:
    """The state after dt seconds straight on, the yaw rate zero, and its derivative F (7, 7)."""
    for a in range(N_STATE):
        for b in range(N_STATE):
            F[a, b] = 1.0 if a == b else 0.0
    F[0, 3] = F[1, 4] = F[2, 5] = dt
    F[6, 6] = 0.0
    for a in range(3):
        moved[a], moved[3 + a] = state[a] + dt * state[3 + a], state[3 + a]
    moved[6] = 0.0


@part
def turning_step(state: FloatArray, dt: float, moved: FloatArray, F: FloatArray) -> None:
    """The state after dt seconds at constant speed and yaw rate, and its derivative F (7, 7).

    The vertical velocity is constant (Y. Bar-Shalom et al. 2001, sec. 11.7).
    """
    w, vx, vy = state[6], state[3], state[4]
    a = w * dt
    s, c = math.sin(a), math.cos(a)
    if abs(a) < 1e-3:  # rad: the series of ∫cos, ∫sin and their derivatives, to 1e-12 exact
        S, C = dt * (1.0 - a * a / 6.0), dt * a / 2.0
        dS, dC = -(dt**2) * a / 3.0, dt**2 / 2.0
    else:
        S, C = s / w, (1.0 - c) / w
        dS, dC = (dt * c - S) / w, (dt * s - C) / w
    for i in range(N_STATE):
        for k in range(N_STATE):
            F[i, k] = 1.0 if i == k else 0.0
    F[0, 3], F[0, 4], F[1, 3], F[1, 4], F[2, 5] = S, -C, C, S, dt
    F[3, 3], F[3, 4], F[4, 3], F[4, 4] = c, -s, s, c
    moved[0], moved[1] = state[0] + S * vx - C * vy, state[1] + C * vx + S * vy
    moved[2] = state[2] + dt * state[5]
    moved[3], moved[4] = c * vx - s * vy, s * vx + c * vy
    moved[5], moved[6] = state[5], w
    F[0, 6], F[1, 6] = dS * vx - dC * vy, dC * vx + dS * vy
    F[3, 6], F[4, 6] = -dt * moved[4], dt * moved[3]


@part
def process_noise(dt: float, accel: float, lift: float, yaw_accel: float, Q: FloatArray) -> None:
    """Q (7, 7), zero before, of white acceleration of the given densities over dt seconds."""
    for a in range(3):
        q = lift**2 if a == 2 else accel**2
        Q[a, a], Q[3 + a, 3 + a] = q * dt**3 / 3.0, q * dt
        Q[a, 3 + a] = Q[3 + a, a] = q * dt**2 / 2.0
    Q[6, 6] = yaw_accel**2 * dt


def update_model(
    state: FloatArray, P: FloatArray, H: FloatArray, value: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """State (7,) and covariance after a linear measurement, and its log-likelihood.

    H (m, 7), value (m,), covariance R (m, m). With S = H P Hᵀ + R = L Lᵀ and W = L⁻¹ H P the
    covariance is P - Wᵀ W; the log-likelihood is without its constant.
    """
    n, m = N_STATE, len(value)
    S, W = np.empty((m, m)), np.empty((m, n + 1))  # the last column of W is the residual
    for i in range(m):
        W[i, n] = value[i]
        for a in range(n):
            W[i, n] -= H[i, a] * state[a]
            W[i, a] = 0.0
            for b in range(n):
                W[i, a] += H[i, b] * P[b, a]
    for i in range(m):
        for j in range(i + 1):
            S[i, j] = R[i, j]
            for a in range(n):
                S[i, j] += W[i, a] * H[j, a]
    factor(S)
    solve_lower(S, W)
    updated, covariance, twice = state.copy(), P.copy(), 0.0
    for i in range(m):
        twice += W[i, n] ** 2 + 2.0 * math.log(S[i, i])
        for a in range(n):
            updated[a] += W[i, a] * W[i, n]
            for b in range(n):
                covariance[a, b] -= W[i, a] * W[i, b]
    return updated, covariance, -0.5 * twice


_FOLDER = code_folder(Path(__file__))
predict_models_compiled = compiled(predict_models, _FOLDER)
update_model_compiled = compiled(update_model, _FOLDER)
