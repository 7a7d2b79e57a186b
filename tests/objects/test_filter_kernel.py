"""The compiled filter: laws of its motion models, and its update by plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.filter_kernel import (
    N_STATE,
    Models,
    predict_models,
    predict_models_compiled,
    process_noise,
    straight_step,
    turning_step,
    update_model,
    update_model_compiled,
)

DENSITIES = (1.5, 0.2, 0.3)
STEPS = [straight_step, turning_step]
Step = Callable[[FloatArray, float, FloatArray, FloatArray], None]


def moved(step: Step, state: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """The state after a step, and its derivative."""
    after, F = np.empty(N_STATE), np.empty((N_STATE, N_STATE))
    step(state, dt, after, F)
    return after, F


def noise(dt: float) -> FloatArray:
    Q = np.zeros((N_STATE, N_STATE))
    process_noise(dt, *DENSITIES, Q)
    return Q


def positive(rng: np.random.Generator, n: int) -> FloatArray:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("yaw_rate", [0.0, 2e-3, 0.4, -1.1])
def test_transitions_are_the_derivatives(
    step: Step, yaw_rate: float, central_differences: Callable[..., FloatArray]
) -> None:
    state = np.array([1.0, -2.0, 0.5, 8.0, 3.0, -0.2, yaw_rate])
    expected = central_differences(lambda x: moved(step, x, 0.13)[0], state, 1e-5)
    np.testing.assert_allclose(moved(step, state, 0.13)[1], expected, atol=1e-6)
    assert np.linalg.eigvalsh(noise(0.13)).min() > -1e-12


def test_a_turning_body_goes_in_a_circle() -> None:
    speed, rate = 5.0, 0.5
    state = np.array([0.0, -speed / rate, 0.0, speed, 0.0, 0.0, rate])
    for _ in range(round(2.0 * np.pi / rate / 0.1)):
        state = moved(turning_step, state, 0.1)[0]
        assert np.linalg.norm(state[:2]) == pytest.approx(speed / rate)
        assert np.linalg.norm(state[3:5]) == pytest.approx(speed)
    left = 2.0 * np.pi / rate - 0.1 * round(2.0 * np.pi / rate / 0.1)
    end = moved(turning_step, state, left)[0]
    np.testing.assert_allclose(end[:2], [0.0, -speed / rate], atol=1e-9)


def test_without_turning_both_go_straight_on() -> None:
    state = np.array([1.0, 2.0, 3.0, 4.0, -5.0, 0.5, 0.0])
    straight, turning = moved(straight_step, state, 0.2)[0], moved(turning_step, state, 0.2)[0]
    np.testing.assert_allclose(turning, straight, atol=1e-12)
    np.testing.assert_allclose(straight[:3], state[:3] + 0.2 * state[3:6])


def test_noise_does_not_depend_on_how_a_span_is_cut() -> None:
    F = moved(straight_step, np.zeros(N_STATE), 0.2)[1][:6, :6]
    Q = noise(0.2)[:6, :6]
    np.testing.assert_allclose(F @ Q @ F.T + Q, noise(0.4)[:6, :6], atol=1e-12)


@pytest.mark.parametrize("predict", [predict_models, predict_models_compiled])
def test_both_models_are_predicted(predict: Callable[..., Models]) -> None:
    rng = np.random.default_rng(3)
    state, P = rng.normal(size=(2, N_STATE)), [positive(rng, N_STATE) for _ in range(2)]
    found = predict(Models(state[0], P[0], state[1], P[1]), 0.1, *DENSITIES)
    Q = [noise(0.1), noise(0.1)]
    Q[0][6, 6] = 1e-6
    for k, (after, covariance) in enumerate([found[:2], found[2:]]):
        expected, F = moved(STEPS[k], state[k], 0.1)
        np.testing.assert_allclose(after, expected, rtol=1e-12)
        np.testing.assert_allclose(covariance, F @ P[k] @ F.T + Q[k], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("update", [update_model, update_model_compiled])
@pytest.mark.parametrize("m", [3, 6, 7])
def test_the_update_is_josephs(
    update: Callable[..., tuple[FloatArray, FloatArray, float]], m: int
) -> None:
    rng = np.random.default_rng(m)
    state, P, R = rng.normal(size=N_STATE), positive(rng, N_STATE), positive(rng, m)
    H, value = rng.normal(size=(m, N_STATE)), rng.normal(size=m)
    S, r = H @ P @ H.T + R, value - H @ state
    gain = P @ H.T @ np.linalg.inv(S)
    A = np.eye(N_STATE) - gain @ H
    updated, covariance, log_likelihood = update(state, P, H, value, R)
    np.testing.assert_allclose(updated, state + gain @ r, rtol=1e-8, atol=1e-10)
    joseph = A @ P @ A.T + gain @ R @ gain.T
    np.testing.assert_allclose(covariance, joseph, rtol=1e-8, atol=1e-10)
    expected = -0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1])
    assert log_likelihood == pytest.approx(expected, rel=1e-9)
