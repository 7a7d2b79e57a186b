"""The compiled consistency of SLAM features against its plain twin."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import chi2_gate, innovation_consistency, innovation_distances

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.physics import gates
from ovmot.vio.innovation_consistency import VELOCITY_BOUND
from ovmot.vio.landmark_kernel import update_by_landmarks_compiled
from ovmot.vio.state import N_BASE, VELOCITY, State, box_minus
from ovmot.vio.update import ekf_update, moved

N_LANDMARKS = 14


@pytest.fixture
def state(make_state: Callable[..., State]) -> State:
    state = make_state(np.random.default_rng(1), 3)
    P = state.covariance.copy()
    P[VELOCITY] *= 0.1
    P[:, VELOCITY] *= 0.1
    return replace(state, covariance=P)


def measurements(state: State, m: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """H (L, m, k), residual (L, m) and degrees of freedom (L,); some rows saw nothing."""
    rng = np.random.default_rng(2)
    k = len(state.covariance) - N_BASE
    H, residual = rng.normal(size=(N_LANDMARKS, m, k)), rng.normal(size=(N_LANDMARKS, m))
    H[rng.random(H.shape) < 0.5] = 0.0
    H[:3, m // 2 :], residual[:3, m // 2 :] = 0.0, 0.0
    H[4], residual[4] = 0.0, 0.0
    dof = np.full(N_LANDMARKS, m)
    dof[:3], dof[4] = m // 2, 0
    residual[5:9] *= 3.0
    residual[10] += 1e4
    return H, residual, dof


@pytest.mark.parametrize("m", [4, 2])
@pytest.mark.parametrize("scale", [1.0, 50.0])
def test_the_update_is_that_of_the_plain_twin(state: State, m: int, scale: float) -> None:
    """Large residuals ask together for a velocity that the prediction rules out."""
    H, residual, dof = measurements(state, m)
    residual, multiplier = scale * residual, 3.0 * scale**2
    columns = np.arange(N_BASE, len(state.covariance))
    P = state.covariance[N_BASE:, N_BASE:]
    distance = innovation_distances(P, H, residual)
    gated = chi2_gate(distance, dof, multiplier)
    plain = innovation_consistency(state, H, residual, columns, distance, dof, gated)
    bounds = multiplier * gates(4, 0.95)[dof]
    passed, weight, error, covariance = update_by_landmarks_compiled(
        state.covariance, H, residual, N_BASE, state.considered, dof, bounds, VELOCITY_BOUND
    )
    np.testing.assert_array_equal(passed, gated)
    assert not passed[[4, 10]].any()
    if plain is None:
        assert not weight.any()
        assert not error.any()
        np.testing.assert_array_equal(covariance, state.covariance)
        return
    np.testing.assert_allclose(weight, plain.weight, atol=1e-9)
    assert scale == 1.0 or (weight > 0.0).sum() < passed.sum()
    ones = np.ones(len(plain.residual))
    expected = ekf_update(state, plain.H, columns, plain.residual, ones)
    deviation = np.sqrt(np.diag(expected.covariance))
    difference = (covariance - expected.covariance) / np.outer(deviation, deviation)
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)
    found = moved(state, error, covariance)
    np.testing.assert_allclose(box_minus(found, expected) / deviation, 0.0, atol=1e-8)
