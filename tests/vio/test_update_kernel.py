"""The compiled algebra of an update against plain NumPy."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import velocity_distance

from ovmot.geometry.arrays import FloatArray
from ovmot.vio import update_kernel
from ovmot.vio.state import N_BASE, State, box_minus
from ovmot.vio.update import ekf_update, innovation_factor, update_by_rows

MakeState = Callable[..., State]


def rows(rng: np.random.Generator, state: State, m: int) -> tuple[FloatArray, FloatArray]:
    """H (m, N - 16) over all coordinates after the time offset, and residual (m,)."""
    return 10.0 * rng.normal(size=(m, len(state.covariance) - N_BASE)), rng.normal(size=m)


@pytest.mark.parametrize("m", [1, 7, 40])
def test_the_update_is_the_plain_one(make_state: MakeState, m: int) -> None:
    rng = np.random.default_rng(m)
    state = make_state(rng, 4)
    H, residual = rows(rng, state, m)
    columns = np.arange(N_BASE, len(state.covariance))
    ours = update_by_rows(state, H, residual, N_BASE)
    plain = ekf_update(state, H, columns, residual, np.ones(m))
    deviation = np.sqrt(np.diag(plain.covariance))
    scale = np.outer(deviation, deviation)
    np.testing.assert_allclose(ours.covariance / scale, plain.covariance / scale, atol=1e-9)
    np.testing.assert_allclose(box_minus(ours, plain) / deviation, 0.0, atol=1e-9)
    np.testing.assert_array_equal(ours.covariance, ours.covariance.T)


def test_no_rows_change_nothing(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(4), 1)
    assert update_by_rows(state, np.empty((0, 6)), np.empty(0), N_BASE) is state


def test_numbers_that_break_down_are_an_error(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(4), 1)
    P = state.covariance.copy()
    P[20, 20] = np.nan
    with pytest.raises(FloatingPointError, match="not finite"):
        update_by_rows(replace(state, covariance=P), np.ones((1, 6)), np.ones(1), N_BASE)


def test_the_velocity_asked_for_is_that_of_the_plain_twin(make_state: MakeState) -> None:
    rng = np.random.default_rng(5)
    state = make_state(rng, 3)
    columns = np.arange(N_BASE, len(state.covariance))
    for m in (1, 2, 12):  # one and two rows say nothing of a third component
        H, residual = rows(rng, state, m)
        S = innovation_factor(state.covariance[np.ix_(columns, columns)], H, np.ones(m))
        ours = update_kernel.asked_velocity_distance(state.covariance, H, residual, N_BASE)
        plain = velocity_distance(state, H, residual, columns, S)
        assert ours == pytest.approx(plain, rel=1e-8)


def test_a_large_row_keeps_the_noise(make_state: MakeState) -> None:
    """Rounded to its largest entry, H P Hᵀ + I has lost its noise: the pivots put it back."""
    state = make_state(np.random.default_rng(6), 2)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    H = np.zeros((3, 12))
    H[:, 0], H[:, 4] = 1e11, [0.0, 3.0, -1.0]
    updated = update_by_rows(replace(state, covariance=P), H, np.zeros(3), N_BASE)
    assert 0.0 < updated.covariance[20, 20] <= 1e-4
    assert np.linalg.eigvalsh(updated.covariance).min() > -1e-16


def test_sizes_are_sorted_stably() -> None:
    size, order = np.array([2.0, np.inf, 1.0, 2.0, 0.5, 1.0]), np.empty(6, dtype=np.int64)
    assert update_kernel.nearest_first(size, order) == 5
    np.testing.assert_array_equal(order[:5], [4, 2, 5, 0, 3])
