from collections.abc import Callable

import numpy as np
import pytest

from ovmot.evaluation.consistency import (
    Nis,
    average,
    average_bounds,
    average_over_runs,
    chi_squared_bounds,
    nees,
    nis,
    normalized_average,
    pose_errors,
    turn_world,
)
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

Path = Callable[[int], FloatArray]


def covariances(rng: np.random.Generator, n: int, k: int) -> FloatArray:
    """Positive definite ones whose axes differ in scale by orders, as rad and metres do."""
    root = rng.standard_normal((n, k, k)) * 10.0 ** rng.uniform(-4, 1, (1, k, 1))
    covariance: FloatArray = root @ np.swapaxes(root, -1, -2)
    return covariance


@pytest.mark.parametrize("k", [1, 3, 6])
def test_nees_of_gaussian_samples_is_chi_squared(k: int) -> None:
    rng = np.random.default_rng(k)
    n = 4000
    P = covariances(rng, n, k)
    errors = (np.linalg.cholesky(P) @ rng.standard_normal((n, k, 1)))[..., 0]
    values = nees(errors, P)
    low, high = average_bounds(k, n)
    found = average(values, k)
    assert found is not None
    assert low <= found.mean <= high
    assert low < k < high
    assert high - low < 0.25
    assert found.share_inside == pytest.approx(0.95, abs=0.015)
    assert (found.count, found.undefined) == (n, 0)


def test_nees_is_that_of_the_inverse() -> None:
    P = np.array([[[4.0, 1.0], [1.0, 2.0]]])
    e = np.array([[1.0, -2.0]])
    assert nees(e, P)[0] == pytest.approx(e[0] @ np.linalg.inv(P[0]) @ e[0])


@pytest.mark.parametrize(
    "bad",
    [
        np.array([[1.0, 1.0], [1.0, 1.0]]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.array([[1.0, 0.0], [0.0, -1.0]]),
        np.zeros((2, 2)),
        np.array([[np.nan, 0.0], [0.0, 1.0]]),
        np.array([[1.0, 1e-7], [1e-7, 1e-14]]),  # singular, hidden by the units
    ],
)
def test_a_singular_covariance_gives_nan_that_is_counted(bad: FloatArray) -> None:
    values = nees(np.ones((2, 2)), np.stack([np.eye(2), bad]))
    assert values[0] == pytest.approx(2.0)
    assert np.isnan(values[1])
    found = average(values, 2)
    assert found is not None
    assert found.mean == pytest.approx(2.0)
    assert (found.count, found.undefined) == (1, 1)


def test_nothing_known_has_no_average() -> None:
    assert average(np.full(3, np.nan), 3) is None
    assert normalized_average(Nis(np.array([np.nan]), np.array([2]))) is None


def test_small_units_alone_do_not_make_a_covariance_singular() -> None:
    P = np.diag([1e-20, 1e4])[None]
    assert nees(np.array([[1e-10, 100.0]]), P)[0] == pytest.approx(2.0)


def test_nis_of_innovations_of_changing_dimension() -> None:
    rng = np.random.default_rng(7)
    sizes = rng.integers(1, 9, 600)
    S = [covariances(rng, 1, int(k))[0] for k in sizes]
    innovations = [np.linalg.cholesky(s) @ rng.standard_normal(len(s)) for s in S]
    squares = nis(innovations, S)
    assert squares.dof.tolist() == sizes.tolist()
    found = normalized_average(squares)
    assert found is not None
    mean, (low, high) = found
    assert mean == pytest.approx(squares.values.sum() / sizes.sum())
    assert low <= mean <= high
    assert low < 1.0 < high
    doubled = normalized_average(nis([2.0 * e for e in innovations], S))
    assert doubled is not None
    assert doubled[0] > doubled[1][1]


def test_bounds_are_those_of_the_textbook() -> None:
    """Bar-Shalom et al. 2001, 5.4.2: 50 runs, 2 degrees of freedom, 95 %: [1.5, 2.6]."""
    low, high = average_bounds(2, 50)
    assert (round(low, 1), round(high, 1)) == (1.5, 2.6)
    assert chi_squared_bounds(3) == pytest.approx((0.2158, 9.3484), abs=1e-4)
    assert average_bounds(3, 5, 4) == average_bounds(3, 20)


def test_average_over_runs_leaves_out_what_is_not_known() -> None:
    values = np.array([[1.0, np.nan, np.nan], [3.0, 5.0, np.nan]])
    np.testing.assert_array_equal(average_over_runs(values), [2.0, 5.0, np.nan])


def test_pose_errors_are_right_perturbations(winding_path: Path) -> None:
    truth = winding_path(20)
    rng = np.random.default_rng(2)
    delta = rng.normal(0.0, 0.1, (20, 6))
    R_estimate = truth[:, :3, :3] @ so3.exp(-delta[:, :3])  # R_true = R_est exp(δθ)
    estimate = se3.make(R_estimate, truth[:, :3, 3] - delta[:, 3:])
    np.testing.assert_allclose(pose_errors(truth, estimate), delta, atol=1e-12)


def test_nees_does_not_depend_on_the_world_it_is_taken_in(winding_path: Path) -> None:
    rng = np.random.default_rng(4)
    truth = winding_path(20)
    P = covariances(rng, 20, 9)
    delta = rng.normal(0.0, 0.1, (20, 6))
    estimate = se3.make(truth[:, :3, :3] @ so3.exp(delta[:, :3]), truth[:, :3, 3] + delta[:, 3:])
    world = se3.make(so3.exp(np.array([0.0, 0.0, 1.3])), np.array([3.0, 2.0, 1.0]))
    before = pose_errors(truth, estimate)
    after = pose_errors(world @ truth, world @ estimate)
    turned = turn_world(P, world[:3, :3])
    np.testing.assert_allclose(after[:, :3], before[:, :3], atol=1e-12)
    for part in (slice(0, 3), slice(3, 6), slice(0, 6)):
        np.testing.assert_allclose(
            nees(after[:, part], turned[:, part, part]), nees(before[:, part], P[:, part, part])
        )
    np.testing.assert_allclose(turned[:, 6:, 6:], world[:3, :3] @ P[:, 6:, 6:] @ world[:3, :3].T)
