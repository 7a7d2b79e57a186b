"""Gates are quantiles of chi-squared; pixel noise and road users' facts hold together."""

import numpy as np
import pytest
from scipy.stats import chi2

from ovmot.physics import (
    CAR_SIZE_M,
    MAX_VEHICLE_SIZE_M,
    PIXEL_SIGMA,
    gate,
    gates,
    tracked_pixel_sigma,
)
from ovmot.settings import FilterSettings


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 6, 50])
@pytest.mark.parametrize("probability", [0.5, 0.95, 0.99, 0.999, 1.0 - 1e-4])
def test_a_gate_lets_its_share_of_true_measurements_pass(dof: int, probability: float) -> None:
    assert gate(dof, probability) == pytest.approx(chi2.ppf(probability, dof), rel=1e-9)


def test_drawn_measurements_pass_at_the_stated_rate() -> None:
    drawn = np.random.default_rng(0).normal(size=(200_000, 3))
    passed = ((drawn**2).sum(1) < gate(3, 0.99)).mean()
    assert passed == pytest.approx(0.99, abs=1e-3)


def test_gates_of_many_degrees_of_freedom_are_those_of_each() -> None:
    expected = [gate(max(dof, 1), 0.99) for dof in range(10)]
    np.testing.assert_allclose(gates(9, 0.99), expected, rtol=1e-12)
    assert not gates(9, 0.99).flags.writeable


def test_a_car_is_a_vehicle() -> None:
    assert all(car < most for car, most in zip(CAR_SIZE_M, MAX_VEHICLE_SIZE_M, strict=True))


def test_the_filter_s_pixel_noise_is_that_of_drifting_patches() -> None:
    settings = FilterSettings()
    assert tracked_pixel_sigma(0) == PIXEL_SIGMA
    assert tracked_pixel_sigma(settings.max_clones) == pytest.approx(settings.pixel_sigma, abs=0.01)
    assert tracked_pixel_sigma(100) == pytest.approx(settings.landmark_pixel_sigma, abs=0.06)
