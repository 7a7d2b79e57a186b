"""Models of motion: laws, and Jacobians as derivatives."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.motion_models import (
    MOTION_MODELS,
    N_STATE,
    Agility,
    constant_turn,
    constant_velocity,
)

AGILITY = Agility(1.5, 0.2, 0.3)


@pytest.mark.parametrize("name", list(MOTION_MODELS))
@pytest.mark.parametrize("yaw_rate", [0.0, 2e-3, 0.4, -1.1])
def test_transitions_are_the_derivatives(
    name: str, yaw_rate: float, central_differences: Callable[..., FloatArray]
) -> None:
    state = np.array([1.0, -2.0, 0.5, 8.0, 3.0, -0.2, yaw_rate])
    model = MOTION_MODELS[name]
    expected = central_differences(lambda x: model(x, 0.13, AGILITY).state, state, 1e-5)
    np.testing.assert_allclose(model(state, 0.13, AGILITY).transition, expected, atol=1e-6)
    assert np.linalg.eigvalsh(model(state, 0.13, AGILITY).noise).min() > -1e-12


def test_a_turning_body_goes_in_a_circle() -> None:
    speed, rate = 5.0, 0.5
    state = np.array([0.0, -speed / rate, 0.0, speed, 0.0, 0.0, rate])
    for _ in range(round(2.0 * np.pi / rate / 0.1)):
        state = constant_turn(state, 0.1, AGILITY).state
        assert np.linalg.norm(state[:2]) == pytest.approx(speed / rate)
        assert np.linalg.norm(state[3:5]) == pytest.approx(speed)
    left = 2.0 * np.pi / rate - 0.1 * round(2.0 * np.pi / rate / 0.1)
    end = constant_turn(state, left, AGILITY).state
    np.testing.assert_allclose(end[:2], [0.0, -speed / rate], atol=1e-9)


def test_without_turning_both_go_straight_on() -> None:
    state = np.array([1.0, 2.0, 3.0, 4.0, -5.0, 0.5, 0.0])
    straight, turning = constant_velocity(state, 0.2, AGILITY), constant_turn(state, 0.2, AGILITY)
    np.testing.assert_allclose(turning.state, straight.state, atol=1e-12)
    np.testing.assert_allclose(straight.state[:3], state[:3] + 0.2 * state[3:6])


def test_noise_does_not_depend_on_how_a_span_is_cut() -> None:
    state = np.zeros(N_STATE)
    whole = constant_velocity(state, 0.4, AGILITY).noise[:6, :6]
    half = constant_velocity(state, 0.2, AGILITY)
    F, Q = half.transition[:6, :6], half.noise[:6, :6]
    np.testing.assert_allclose(F @ Q @ F.T + Q, whole, atol=1e-12)
