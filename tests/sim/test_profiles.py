"""Smooth steps and the road's centre line."""

import numpy as np
import pytest

from ovmot.sim.profiles import Road, SmoothSteps

PROFILE = SmoothSteps.make((1.0, 0.5), (2.5, 3.0), (4.0, 3.0), (6.0, -1.0))


def test_steps_meet_their_knots_and_rest_between_equal_values() -> None:
    np.testing.assert_allclose(PROFILE(PROFILE.knots), PROFILE.values)
    np.testing.assert_allclose(PROFILE(np.array([-9.0, 2.5, 3.3, 4.0, 99.0])), [0.5, 3, 3, 3, -1])


def test_integral_is_that_of_the_function() -> None:
    x = np.linspace(-1.0, 8.0, 90_001)
    y = PROFILE(x)
    trapezes = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
    exact = PROFILE.integral(x)
    np.testing.assert_allclose(exact - exact[0], trapezes, atol=1e-7)
    assert abs(float(PROFILE.integral(np.array(1.0)))) < 1e-12


def test_refuses_knots_that_do_not_rise() -> None:
    with pytest.raises(ValueError, match="rise"):
        SmoothSteps.make((0.0, 1.0), (0.0, 2.0))


def test_constant_curvature_is_a_circle() -> None:
    radius = 40.0
    road = Road(SmoothSteps.make((0.0, 1.0 / radius)), 100.0)
    s = np.linspace(0.0, 100.0, 41)
    xy, yaw = road.at(s, offset=3.0)
    np.testing.assert_allclose(np.linalg.norm(xy - [0.0, radius], axis=1), radius - 3.0, atol=1e-6)
    np.testing.assert_allclose(yaw, s / radius)


def test_road_goes_straight_on_beyond_its_ends() -> None:
    road = Road(SmoothSteps.make((0.0, 0.01)), 50.0)
    end, yaw = road.at(np.array(50.0))
    beyond, same = road.at(np.array(60.0))
    assert same == pytest.approx(yaw, rel=1e-12)
    np.testing.assert_allclose(beyond - end, 10.0 * np.array([np.cos(yaw), np.sin(yaw)]))
    np.testing.assert_allclose(road.at(np.array(-4.0))[0], [-4.0, 0.0], atol=1e-12)
