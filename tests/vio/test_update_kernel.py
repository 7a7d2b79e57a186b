"""The compiled algebra of an update against plain NumPy."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import velocity_distance

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.settings import CalibrationSettings
from ovmot.vio.online_calibration import make_calibration
from ovmot.vio.state import N_BASE, State, box_minus
from ovmot.vio.update import ekf_update, innovation_factor, moved
from ovmot.vio.update_kernel import innovation, nearest_first, update_if_consistent

MakeState = Callable[..., State]


def rows(rng: np.random.Generator, state: State, m: int) -> tuple[FloatArray, FloatArray]:
    """H (m, N - 16) over all coordinates after the time offset, and residual (m,)."""
    return 10.0 * rng.normal(size=(m, len(state.covariance) - N_BASE)), rng.normal(size=m)


def with_centers(rng: np.random.Generator, state: State, rig: StereoRig) -> State:
    """The state with considered image centres, correlated with all else."""
    calibration, _ = make_calibration(rig, CalibrationSettings())
    n = len(state.covariance) + len(calibration)
    A = 1e-2 * rng.normal(size=(n, n))
    return replace(state, calibration=calibration, covariance=A @ A.T + 1e-5 * np.eye(n))


def updated(
    P: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    bound: float = np.inf,
    considered: tuple[int, int] = (0, 0),
) -> tuple[FloatArray, FloatArray] | None:
    """Error and covariance after an update; None where the velocity is beyond the bound."""
    m, n = len(H), len(P)
    HP, S, error, after = np.empty((m, n)), np.empty((m + 4, m)), np.empty(n), np.empty((n, n))
    innovation(P, H, N_BASE, HP, S)
    done = update_if_consistent(P, HP, S, residual, considered, bound, error, after)
    return (error, after) if done else None


@pytest.mark.parametrize("m", [1, 7, 40])
@pytest.mark.parametrize("considering", [False, True])
def test_the_update_is_the_plain_one(
    make_state: MakeState, rig: StereoRig, m: int, considering: bool
) -> None:
    rng = np.random.default_rng(m)
    state = make_state(rng, 4)
    if considering:
        state = with_centers(rng, state, rig)
    H, residual = rows(rng, state, m)
    columns = np.arange(N_BASE, len(state.covariance))
    found = updated(state.covariance, H, residual, considered=state.considered)
    assert found is not None
    ours = moved(state, *found)
    plain = ekf_update(state, H, columns, residual, np.ones(m))
    deviation = np.sqrt(np.diag(plain.covariance))
    scale = np.outer(deviation, deviation)
    np.testing.assert_allclose(ours.covariance / scale, plain.covariance / scale, atol=1e-9)
    np.testing.assert_allclose(box_minus(ours, plain) / deviation, 0.0, atol=1e-9)
    np.testing.assert_array_equal(ours.covariance, ours.covariance.T)
    begin, end = state.considered
    assert end - begin == (4 if considering else 0)
    np.testing.assert_array_equal(
        ours.covariance[begin:end, begin:end], state.covariance[begin:end, begin:end]
    )
    assert not ours.calibration.deviation.any()


def test_numbers_that_break_down_are_an_error(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(4), 1)
    P = state.covariance.copy()
    P[18, 18] = np.nan
    found = updated(P, np.ones((1, 6)), np.ones(1))
    assert found is None  # no gate lets it pass
    error = np.zeros(len(P))
    error[3] = np.nan
    with pytest.raises(FloatingPointError, match="not finite"):
        moved(state, error, P)


def test_the_velocity_asked_for_is_that_of_the_plain_twin(make_state: MakeState) -> None:
    rng = np.random.default_rng(5)
    state = make_state(rng, 3)
    columns, P = np.arange(N_BASE, len(state.covariance)), state.covariance
    for m in (1, 2, 12):  # one and two rows say nothing of a third component
        H, residual = rows(rng, state, m)
        L = innovation_factor(P[np.ix_(columns, columns)], H, np.ones(m))
        distance = velocity_distance(state, H, residual, columns, L)
        assert updated(P, H, residual, distance * (1.0 + 1e-8)) is not None
        assert updated(P, H, residual, distance * (1.0 - 1e-8)) is None


def test_a_large_row_keeps_the_noise(make_state: MakeState) -> None:
    """Rounded to its largest entry, H P Hᵀ + I has lost its noise: the pivots put it back."""
    state = make_state(np.random.default_rng(6), 2)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    H = np.zeros((3, 12))
    H[:, 0], H[:, 4] = 1e11, [0.0, 3.0, -1.0]
    found = updated(P, H, np.zeros(3))
    assert found is not None
    assert 0.0 < found[1][20, 20] <= 1e-4
    assert np.linalg.eigvalsh(found[1]).min() > -1e-16


def test_sizes_are_sorted_stably() -> None:
    size, order = np.array([2.0, np.inf, 1.0, 2.0, 0.5, 1.0]), np.empty(6, dtype=np.int64)
    assert nearest_first(size, order) == 5
    np.testing.assert_array_equal(order[:5], [4, 2, 5, 0, 3])
