"""Features that ask together for a velocity that the IMU rules out lose their weight."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import innovation_consistency, velocity_distance
from scipy.stats import chi2

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.state import VELOCITY, State
from ovmot.vio.update import innovation_factor

COLUMNS = np.arange(VELOCITY.start, VELOCITY.stop)
SIGMA_MPS = 0.1


@pytest.fixture
def state(make_state: Callable[..., State]) -> State:
    """A state whose velocity is known to 0.1 m/s."""
    state = make_state(np.random.default_rng(1), 1)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    P[VELOCITY, VELOCITY] = SIGMA_MPS**2 * np.eye(3)
    return replace(state, covariance=P)


def measurements(n_features: int) -> FloatArray:
    """H (F, 4, 3) of features that measure the velocity."""
    return 5.0 * np.random.default_rng(2).normal(size=(n_features, 4, 3))


def full_dof(n_features: int) -> IntArray:
    return np.full(n_features, 4)


def test_the_distance_is_chi_squared_with_3_degrees_of_freedom(state: State) -> None:
    rng, H = np.random.default_rng(3), measurements(10).reshape(-1, 3)
    L = innovation_factor(SIGMA_MPS**2 * np.eye(3), H, np.ones(len(H)))
    draws = rng.normal(size=(400, len(H))) @ L.T
    d = [velocity_distance(state, H, residual, COLUMNS, L) for residual in draws]
    low, high = np.asarray(chi2.ppf([0.005, 0.995], 3 * 400)) / 400
    assert low < np.mean(d) < high


def test_weights_are_huber_s_by_the_true_degrees_of_freedom(state: State) -> None:
    """Nullspace projection may leave more rows that are not zero than degrees of freedom."""
    H, residual = measurements(4), np.zeros((4, 4))
    distance = np.array([4.0, 16.0, 0.5, 9.0])
    dof = np.array([1, 4, 3, 1])
    passed = np.array([True, True, True, False])
    update = innovation_consistency(state, H, residual, COLUMNS, distance, dof, passed)
    assert update is not None
    # squared, the weight of a residual is 1 over its size in standard deviations
    np.testing.assert_allclose(update.weight, [2.0**-0.5, 2.0**-0.5, 1.0, 0.0])


def test_the_update_is_the_compressed_one_of_all_weighted_rows(state: State) -> None:
    rng, H = np.random.default_rng(4), measurements(6)
    H[0, 2:] = 0.0  # seen by one camera only
    residual = 0.1 * rng.normal(size=(6, 4))
    residual[0, 2:] = 0.0
    distance, passed = np.full(6, 1.0), np.ones(6, dtype=np.bool_)
    distance[1] = 64.0
    update = innovation_consistency(state, H, residual, COLUMNS, distance, full_dof(6), passed)
    assert update is not None
    rows = (update.weight[:, None, None] * H).reshape(-1, 3)
    np.testing.assert_allclose(update.H.T @ update.H, rows.T @ rows, rtol=1e-9)
    weighted = (update.weight[:, None] * residual).ravel()
    np.testing.assert_allclose(update.H.T @ update.residual, rows.T @ weighted, atol=1e-9)
    S = update.H @ (SIGMA_MPS**2 * np.eye(3)) @ update.H.T + np.eye(len(update.residual))
    np.testing.assert_allclose(update.L @ update.L.T, S, rtol=1e-9, atol=1e-12)


def test_a_majority_that_asks_for_another_velocity_is_left_out(state: State) -> None:
    """Ten of sixteen features are on a lorry that drives off at 10 m/s; the IMU knows better."""
    H = measurements(16)
    lorry = np.arange(16) >= 6
    residual = np.where(lorry[:, None], H @ np.array([10.0, 0.0, 0.0]), 0.0)
    distance = np.where(lorry, 8.0, 1.0)
    passed = np.ones(16, dtype=np.bool_)
    update = innovation_consistency(state, H, residual, COLUMNS, distance, full_dof(16), passed)
    assert update is not None
    assert not update.weight[lorry].any()
    assert (update.weight > 0.0).sum() >= 3
    # a velocity that the prediction allows is no contradiction
    slow = np.where(lorry[:, None], H @ np.array([0.05, 0.0, 0.0]), 0.0)
    update = innovation_consistency(state, H, slow, COLUMNS, distance, full_dof(16), passed)
    assert update is not None
    assert (update.weight > 0.0).all()


def test_none_where_no_three_features_are_consistent(state: State) -> None:
    H, passed = measurements(5), np.ones(5, dtype=np.bool_)
    residual = H @ np.array([0.0, 3.0, 0.0])
    distance = np.full(5, 4.0)
    arguments = COLUMNS, distance, full_dof(5)
    assert innovation_consistency(state, H, residual, *arguments, passed) is None
    assert innovation_consistency(state, H, residual, *arguments, ~passed) is None
