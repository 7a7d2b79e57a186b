"""Motion models of a body, each a function of a state and a time step.

State (7,): position x, y, z; velocity x, y, z; yaw rate about the vertical; in world, SI.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.physics import ACCEL_SIGMA_MPS2

POSITION, VELOCITY, YAW_RATE = slice(0, 3), slice(3, 6), 6
N_STATE = 7


@dataclass(frozen=True, slots=True)
class Agility:
    """Process noise densities: accelerations along the ground and upwards in m/s²/√Hz, the yaw
    acceleration in rad/s²/√Hz."""

    accel: float
    lift: float
    yaw_accel: float


ROAD_USER_AGILITY = Agility(accel=ACCEL_SIGMA_MPS2, lift=0.2, yaw_accel=0.3)
"""White acceleration that gives a road user's standard deviation after one second."""


@dataclass(frozen=True, slots=True)
class Step:
    """A state (7,) after a step, its derivative by the one before (7, 7), and the noise (7, 7)."""

    state: FloatArray
    transition: FloatArray
    noise: FloatArray


def constant_velocity(state: FloatArray, dt: float, agility: Agility) -> Step:
    """Straight on; the yaw rate is zero."""
    F = np.eye(N_STATE)
    F[POSITION, VELOCITY] = dt * np.eye(3)
    F[YAW_RATE, YAW_RATE] = 0.0
    moved = F @ state
    Q = _noise(dt, agility)
    Q[YAW_RATE, YAW_RATE] = 1e-6  # rad²/s²: zero, but regular
    return Step(moved, F, Q)


def constant_turn(state: FloatArray, dt: float, agility: Agility) -> Step:
    """Constant speed and yaw rate, constant vertical velocity (Y. Bar-Shalom et al. 2001, sec.
    11.7)."""
    w = float(state[YAW_RATE])
    vx, vy = state[3], state[4]
    s, c, S, C, dS, dC = _turn(w, dt)
    F = np.eye(N_STATE)
    F[0, 3:5], F[1, 3:5] = (S, -C), (C, S)
    F[2, 5] = dt
    F[3, 3:5], F[4, 3:5] = (c, -s), (s, c)
    moved = F @ state
    F[0, YAW_RATE], F[1, YAW_RATE] = dS * vx - dC * vy, dC * vx + dS * vy
    F[3, YAW_RATE], F[4, YAW_RATE] = -dt * moved[4], dt * moved[3]
    return Step(moved, F, _noise(dt, agility))


MotionModel = Callable[[FloatArray, float, Agility], Step]
MOTION_MODELS: dict[str, MotionModel] = {
    "constant_velocity": constant_velocity,
    "constant_turn": constant_turn,
}


def _turn(w: float, dt: float) -> tuple[float, float, float, float, float, float]:
    """sin, cos of w dt; ∫cos, ∫sin over the step, and the derivatives of these two by w."""
    a = w * dt
    s, c = np.sin(a), np.cos(a)
    if abs(a) < 1e-3:  # rad: the series, to 1e-12 exact
        return s, c, dt * (1.0 - a * a / 6.0), dt * a / 2.0, -(dt**2) * a / 3.0, dt**2 / 2.0
    S, C = s / w, (1.0 - c) / w
    return s, c, S, C, (dt * c - S) / w, (dt * s - C) / w


def _noise(dt: float, agility: Agility) -> FloatArray:
    """White acceleration of the given densities."""
    Q = np.zeros((N_STATE, N_STATE))
    q = np.diag([agility.accel, agility.accel, agility.lift]) ** 2
    Q[POSITION, POSITION] = q * dt**3 / 3.0
    Q[POSITION, VELOCITY] = Q[VELOCITY, POSITION] = q * dt**2 / 2.0
    Q[VELOCITY, VELOCITY] = q * dt
    Q[YAW_RATE, YAW_RATE] = agility.yaw_accel**2 * dt
    return Q
