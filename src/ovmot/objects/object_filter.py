"""The filter of one body: its motion models side by side, compared by their likelihoods.

A static multiple-model estimator with exponential weights in time (Y. Bar-Shalom et al. 2001, sec.
11.6): each model has a Kalman filter of its own, the estimate is that of the likelier one.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.filter_kernel import (
    N_STATE,
    Models,
    predict_models_compiled,
    update_model_compiled,
)
from ovmot.objects.motion_models import POSITION, VELOCITY, YAW_RATE, Agility

_MEMORY = 0.85  # factor of past log-likelihoods, per measurement
_UNKNOWN_YAW_RATE = 0.3  # rad/s
_HEADSTART = 2.0  # log-likelihood by which the simpler model is preferred


@dataclass(frozen=True, slots=True)
class Estimate:
    """State (7,) and covariance (7, 7) of one model, and its recent log-likelihood."""

    state: FloatArray
    covariance: FloatArray
    log_likelihood: float = 0.0


@dataclass(frozen=True, slots=True)
class BodyFilter:
    """Estimates by model name, at one time."""

    timestamp_ns: int
    models: dict[str, Estimate]

    @property
    def best(self) -> Estimate:
        """That of the likelier model."""
        return self.models[self.model]

    @property
    def model(self) -> str:
        """The likelier model's name; turning has to be clearly likelier than straight on."""
        turning = self.models["constant_turn"].log_likelihood
        straight = self.models["constant_velocity"].log_likelihood
        return "constant_turn" if turning > straight + _HEADSTART else "constant_velocity"


@dataclass(frozen=True, slots=True)
class Observation:
    """A linear measurement: H (m, 7), value (m,), covariance (m, m)."""

    H: FloatArray
    value: FloatArray
    covariance: FloatArray


def start_filter(timestamp_ns: int, observation: Observation) -> BodyFilter:
    """From a first measurement of position and velocity, and of the yaw rate if it has one."""
    state = np.zeros(N_STATE)
    P = np.zeros((N_STATE, N_STATE))
    P[YAW_RATE, YAW_RATE] = _UNKNOWN_YAW_RATE**2
    index = np.argmax(observation.H != 0.0, axis=1)
    state[index] = observation.value
    P[np.ix_(index, index)] = observation.covariance
    straight = state.copy()
    straight[YAW_RATE] = 0.0
    return BodyFilter(
        timestamp_ns,
        {"constant_velocity": Estimate(straight, P), "constant_turn": Estimate(state, P)},
    )


def observe(
    position: FloatArray, velocity: FloatArray, covariance: FloatArray,
    yaw_rate: float = float("nan"), yaw_rate_variance: float = float("nan"),
) -> Observation:  # fmt: skip
    """Position and velocity (3,) with covariance (6, 6), and the yaw rate unless it is NaN."""
    known = np.isfinite(yaw_rate)
    m = 7 if known else 6
    H = np.eye(N_STATE)[:m]
    R = np.zeros((m, m))
    R[:6, :6] = covariance
    value = np.concatenate([position, velocity, [yaw_rate]])[:m]
    if known:
        R[6, 6] = yaw_rate_variance
    return Observation(H, value, R)


def predict(body: BodyFilter, timestamp_ns: int, agility: Agility) -> BodyFilter:
    """All models predicted to a time."""
    straight, turning = body.models["constant_velocity"], body.models["constant_turn"]
    moved = predict_models_compiled(
        Models(straight.state, straight.covariance, turning.state, turning.covariance),
        1e-9 * (timestamp_ns - body.timestamp_ns), agility.accel, agility.lift, agility.yaw_accel,
    )  # fmt: skip
    models = {
        "constant_velocity": Estimate(moved.straight, moved.straight_cov, straight.log_likelihood),
        "constant_turn": Estimate(moved.turning, moved.turning_cov, turning.log_likelihood),
    }
    return BodyFilter(timestamp_ns, models)


def update(body: BodyFilter, observation: Observation) -> BodyFilter:
    """All models and their likelihoods updated."""
    models = {name: _updated(e, observation) for name, e in body.models.items()}
    return replace(body, models=models)


def distance(body: BodyFilter, observation: Observation) -> float:
    """Squared Mahalanobis distance of a measurement from its prediction."""
    e = body.best
    S = observation.H @ e.covariance @ observation.H.T + observation.covariance
    r = observation.value - observation.H @ e.state
    return float(r @ np.linalg.solve(S, r))


def _updated(estimate: Estimate, observation: Observation) -> Estimate:
    state, covariance, log_likelihood = update_model_compiled(
        estimate.state, estimate.covariance, observation.H, observation.value,
        observation.covariance,
    )  # fmt: skip
    return Estimate(state, covariance, _MEMORY * estimate.log_likelihood + log_likelihood)


def position_of(estimate: Estimate) -> FloatArray:
    """Position (3,)."""
    return estimate.state[POSITION]


def velocity_of(estimate: Estimate) -> FloatArray:
    """Velocity (3,)."""
    return estimate.state[VELOCITY]
