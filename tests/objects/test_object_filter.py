"""The filter of one body: the Kalman update, and which model is the likelier one."""

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.motion_models import Agility
from ovmot.objects.object_filter import (
    BodyFilter,
    distance,
    observe,
    position_of,
    predict,
    start_filter,
    update,
    velocity_of,
)

AGILITY = Agility(1.5, 0.2, 0.3)
P = np.diag([0.04, 0.04, 0.04, 0.09, 0.09, 0.09])
FRAME_NS = 100_000_000


def circle(t: float, rate: float, speed: float = 6.0) -> tuple[FloatArray, FloatArray]:
    a = rate * t
    p = np.array([np.sin(a), 1.0 - np.cos(a), 0.0]) * speed / rate
    return p, speed * np.array([np.cos(a), np.sin(a), 0.0])


def after(rate: float, frames: int = 20) -> BodyFilter:
    """The filter of a body that turns at a rate, measured without error but for the yaw rate."""
    body = start_filter(0, observe(*circle(0.0, rate), P))
    for k in range(1, frames):
        body = predict(body, k * FRAME_NS, AGILITY)
        body = update(body, observe(*circle(0.1 * k, rate), P))
    return body


@pytest.mark.parametrize(("rate", "model"), [(1e-6, "constant_velocity"), (0.8, "constant_turn")])
def test_the_likelier_model_speaks(rate: float, model: str) -> None:
    body = after(rate)
    assert body.model == model
    p, v = circle(1.9, rate)
    np.testing.assert_allclose(position_of(body.best), p, atol=0.3)
    np.testing.assert_allclose(velocity_of(body.best), v, atol=0.5)


def test_a_filter_starts_with_its_measurement() -> None:
    position, velocity = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 0.1])
    body = start_filter(7, observe(position, velocity, P, 0.2, 0.01))
    assert body.timestamp_ns == 7
    turning = body.models["constant_turn"]
    np.testing.assert_array_equal(turning.state, [1.0, 2.0, 3.0, 4.0, 5.0, 0.1, 0.2])
    np.testing.assert_array_equal(turning.covariance[:6, :6], P)
    assert turning.covariance[6, 6] == 0.01
    assert body.models["constant_velocity"].state[6] == 0.0


def test_an_update_is_the_information_sum() -> None:
    body = start_filter(0, observe(np.zeros(3), np.zeros(3), P))
    value = np.array([0.1, 0.2, 0.0, 0.3, -0.1, 0.0])
    R = 2.0 * P + 0.01
    updated = update(body, observe(value[:3], value[3:], R)).models["constant_velocity"]
    information = np.linalg.inv(P) + np.linalg.inv(R)
    np.testing.assert_allclose(np.linalg.inv(updated.covariance[:6, :6]), information, rtol=1e-6)
    expected = np.linalg.solve(information, np.linalg.solve(R, value))
    np.testing.assert_allclose(updated.state[:6], expected, atol=1e-9)


def test_the_distance_is_of_the_innovation() -> None:
    body = start_filter(0, observe(np.zeros(3), np.zeros(3), P))
    off = np.array([0.3, 0.0, 0.0])
    assert distance(body, observe(off, np.zeros(3), P)) == pytest.approx(0.09 / 0.08)
