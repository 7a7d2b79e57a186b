"""The one function that changes the covariance by a measurement."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import compress
from scipy.stats import chi2

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import CalibrationSettings
from ovmot.vio.online_calibration import make_calibration
from ovmot.vio.state import State, box_minus
from ovmot.vio.update import (
    ekf_update,
    innovation_distance,
    innovation_factor,
    triangular_part,
)

MakeState = Callable[..., State]


def measurement(
    rng: np.random.Generator, n: int, m: int, k: int
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """H, columns (in no order), residual and variance."""
    columns = rng.permutation(n)[:k].astype(np.int64)
    return rng.normal(size=(m, k)), columns, 0.1 * rng.normal(size=m), rng.uniform(0.01, 0.1, m)


def test_update_is_that_of_the_information_form(make_state: MakeState) -> None:
    rng = np.random.default_rng(1)
    state = make_state(rng, 2)
    n = len(state.covariance)
    H, columns, residual, variance = measurement(rng, n, 7, 10)
    updated = ekf_update(state, H, columns, residual, variance)
    H_full = np.zeros((7, n))
    H_full[:, columns] = H
    information = np.linalg.inv(state.covariance) + H_full.T @ (H_full / variance[:, None])
    P = np.linalg.inv(information)
    np.testing.assert_allclose(updated.covariance, P, atol=1e-9)
    np.testing.assert_allclose(
        box_minus(updated, state), P @ H_full.T @ (residual / variance), atol=1e-9
    )
    assert np.trace(P) < 0.9 * np.trace(state.covariance)


def test_what_is_considered_has_no_gain(make_state: MakeState, rig: StereoRig) -> None:
    """The covariance is that of Joseph's form, (I - K H) P (I - K H)ᵀ + K R Kᵀ, which holds for any
    gain: here the optimal one without the rows of what is considered (S. F. Schmidt, 1966)."""
    rng = np.random.default_rng(9)
    calibration, variance = make_calibration(rig, CalibrationSettings())
    state = make_state(rng, 2)
    n = len(state.covariance) + len(variance)
    A = rng.normal(size=(n, n))
    state = replace(state, calibration=calibration, covariance=1e-2 * A @ A.T)
    H, columns, residual, R = measurement(rng, n, 7, n)
    updated = ekf_update(state, H, columns, residual, R)
    H_full, P = np.empty((7, n)), state.covariance
    H_full[:, columns] = H
    K = np.linalg.solve(H_full @ P @ H_full.T + np.diag(R), H_full @ P).T
    K[slice(*state.considered)] = 0.0
    left = np.eye(n) - K @ H_full
    joseph = left @ P @ left.T + (K * R) @ K.T
    np.testing.assert_allclose(updated.covariance, joseph, atol=1e-9)
    np.testing.assert_allclose(box_minus(updated, state), K @ residual, atol=1e-9)
    assert not updated.calibration.deviation.any()


def test_two_updates_are_one(make_state: MakeState) -> None:
    rng = np.random.default_rng(2)
    state = make_state(rng, 1)
    H, columns, _, variance = measurement(rng, len(state.covariance), 6, 9)
    none = np.zeros(6)
    together = ekf_update(state, H, columns, none, variance)
    first = ekf_update(state, H[:2], columns, none[:2], variance[:2])
    then = ekf_update(first, H[2:], columns, none[2:], variance[2:])
    np.testing.assert_allclose(then.covariance, together.covariance, atol=1e-12)


def test_covariance_stays_positive_after_1000_updates(make_state: MakeState) -> None:
    rng = np.random.default_rng(3)
    state = make_state(rng, 3)
    n = len(state.covariance)
    scale = 10.0 ** rng.uniform(-4.0, 1.0, n)  # as far apart as time offset and position
    state = replace(state, covariance=state.covariance * scale[:, None] * scale)
    for _ in range(1000):
        H, columns, residual, variance = measurement(rng, n, int(rng.integers(1, 12)), 12)
        state = ekf_update(state, H, columns, 1e-3 * residual, 1e-3 * variance)
        # the state grows uncertain again, in a few directions
        grown = scale * rng.normal(size=n) * (rng.random(n) < 0.2)
        state = replace(state, covariance=state.covariance + 1e-4 * np.outer(grown, grown))
    P = state.covariance
    np.testing.assert_array_equal(P, P.T)
    deviation = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(deviation, deviation)).min() > 0.0
    assert deviation.max() < 0.1


def test_no_rows_change_nothing(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(4), 1)
    none = np.empty(0)
    assert ekf_update(state, np.empty((0, 3)), np.arange(3), none, none) is state


def test_innovation_distance_is_mahalanobis(make_state: MakeState) -> None:
    rng = np.random.default_rng(5)
    state = make_state(rng, 2)
    H, columns, residual, variance = measurement(rng, len(state.covariance), 5, 8)
    S = H @ state.covariance[np.ix_(columns, columns)] @ H.T + np.diag(variance)
    expected = residual @ np.linalg.inv(S) @ residual
    assert innovation_distance(state, H, columns, residual, variance) == pytest.approx(expected)
    # over residuals drawn from S it is chi-squared with 5 degrees of freedom
    draws = rng.normal(size=(500, 5)) @ np.linalg.cholesky(S).T
    d = [innovation_distance(state, H, columns, r, variance) for r in draws]
    low, high = (float(chi2.ppf(q, 5 * 500)) / 500 for q in (0.005, 0.995))
    assert low < np.mean(d) < high


@pytest.mark.parametrize("m", [3, 8, 9, 60])
def test_compression_keeps_the_information(m: int) -> None:
    rng = np.random.default_rng(6)
    H, residual = rng.normal(size=(m, 8)), rng.normal(size=m)
    H[:, 5] = 2.0 * H[:, 1]  # an unobservable direction
    short, r = compress(H, residual)
    assert len(short) == len(r) == min(m, 8)
    np.testing.assert_allclose(short.T @ short, H.T @ H, atol=1e-12)
    np.testing.assert_allclose(short.T @ r, H.T @ residual, atol=1e-12)


def test_compression_gives_the_same_update(make_state: MakeState) -> None:
    rng = np.random.default_rng(7)
    state = make_state(rng, 1)
    H, columns, residual, _ = measurement(rng, len(state.covariance), 40, 6)
    plain = ekf_update(state, H, columns, residual, np.ones(40))
    short, r = compress(H, residual)
    brief = ekf_update(state, short, columns, r, np.ones(len(r)))
    np.testing.assert_allclose(brief.covariance, plain.covariance, atol=1e-12)
    np.testing.assert_allclose(box_minus(brief, plain), 0.0, atol=1e-12)


@pytest.mark.parametrize("shape", [(300, 40), (40, 40), (5, 12), (7, 1)])
def test_the_triangular_part_is_that_of_a_qr(shape: tuple[int, int]) -> None:
    A = np.random.default_rng(9).normal(size=shape)
    before = A.copy()
    R = triangular_part(A)
    assert R.shape == (min(shape), shape[1])
    np.testing.assert_array_equal(R, np.triu(R))
    np.testing.assert_allclose(R.T @ R, A.T @ A, atol=1e-10)
    np.testing.assert_array_equal(A, before)


def test_a_factor_that_is_known_gives_the_same_update(make_state: MakeState) -> None:
    rng = np.random.default_rng(11)
    state = make_state(rng, 1)
    H, columns, residual, variance = measurement(rng, len(state.covariance), 5, 6)
    L = innovation_factor(state.covariance[np.ix_(columns, columns)], H, variance)
    plain = ekf_update(state, H, columns, residual, variance)
    given = ekf_update(state, H, columns, residual, variance, L)
    np.testing.assert_array_equal(given.covariance, plain.covariance)
    other = ekf_update(state, H, columns, residual, variance, 2.0 * L)
    assert np.trace(other.covariance) > np.trace(plain.covariance)


def test_a_large_row_does_not_swallow_the_noise(make_state: MakeState) -> None:
    """In H P Hᵀ + R, rounded to its largest entry, the noise is lost, and it has no factor.

    The three measurements know their mean very well; what is beside it is as noisy as ever.
    """
    state = make_state(np.random.default_rng(6), 2)
    P = np.diag(np.full(len(state.covariance), 1e-4))
    state = replace(state, covariance=P)
    H = np.array([[1e11, 0.0], [1e11, 3.0], [1e11, -1.0]])
    columns, variance = np.array([0, 20]), np.ones(3)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(H @ P[:2, :2] @ H.T + np.eye(3))
    updated = ekf_update(state, H, columns, np.zeros(3), variance)
    assert abs(updated.covariance[0, 0]) < 1e-16
    spread = np.square(H[:, 1] - H[:, 1].mean()).sum()
    assert updated.covariance[20, 20] == pytest.approx(1.0 / (1e4 + spread), rel=1e-5)
    assert np.linalg.eigvalsh(updated.covariance).min() > -1e-16


def test_innovation_factor_takes_a_singular_covariance() -> None:
    """A clone is a copy of the pose; a time offset that is known has no variance."""
    rng = np.random.default_rng(7)
    F = rng.normal(size=(8, 5)) * 10.0 ** np.arange(-4, 4)[:, None]
    F[7] = 0.0
    F[6] = F[0]
    H, variance = rng.normal(size=(6, 8)), rng.uniform(0.5, 2.0, 6)
    L = innovation_factor(F @ F.T, H, variance)
    np.testing.assert_allclose(L @ L.T, H @ F @ F.T @ H.T + np.diag(variance), rtol=1e-9)
    np.testing.assert_array_equal(L, np.tril(L))
