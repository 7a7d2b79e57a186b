"""Compiled algebra of small matrices against NumPy."""

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.small_matrices import (
    add_products,
    cross,
    eigen_symmetric,
    factor,
    invert_symmetric,
    solve_lower,
    solve_positive,
    squared_mahalanobis,
    whiten,
)


@pytest.fixture(params=range(4))
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


def positive(rng: np.random.Generator, n: int) -> FloatArray:
    A = rng.normal(size=(n, n))
    return A @ A.T + np.eye(n)


def test_the_inverse_of_the_upper_triangle(rng: np.random.Generator) -> None:
    N, out = positive(rng, 3), np.empty((3, 3))
    invert_symmetric(np.triu(N), out)
    np.testing.assert_allclose(out, np.linalg.inv(N), rtol=1e-9)


def test_the_cross_product(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 3))
    found = cross((a[0], a[1], a[2]), (b[0], b[1], b[2]))
    np.testing.assert_allclose(found, np.cross(a, b), atol=1e-14)


def test_products_are_added(rng: np.random.Generator) -> None:
    rows, out = rng.normal(size=(4, 5)), np.ones((5, 5))
    add_products(rows, out)
    np.testing.assert_allclose(out, 1.0 + rows.T @ rows, rtol=1e-12)


def test_whitened_rows_have_unit_covariance(rng: np.random.Generator) -> None:
    S, rows = positive(rng, 4), rng.normal(size=(4, 3))
    factor, white = np.tril(S), rows.copy()
    whiten(factor, white, 2)
    L = np.linalg.cholesky(S)
    np.testing.assert_allclose(np.tril(factor, -1), np.tril(L, -1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.diag(factor), 1.0 / np.diag(L), rtol=1e-9)
    expected = np.column_stack([np.linalg.solve(L, rows[:, :2]), rows[:, 2]])
    np.testing.assert_allclose(white, expected, rtol=1e-9, atol=1e-12)


def test_the_squared_distance(rng: np.random.Generator) -> None:
    C, error = positive(rng, 3), rng.normal(size=3)
    expected = error @ np.linalg.solve(C, error)
    np.testing.assert_allclose(squared_mahalanobis(error, C), expected, rtol=1e-9)


def test_the_solution(rng: np.random.Generator) -> None:
    A, b = positive(rng, 6), rng.normal(size=6)
    x = b.copy()
    solve_positive(np.tril(A), x)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-9, atol=1e-12)


def test_the_factor_and_its_inverse(rng: np.random.Generator) -> None:
    A, X = positive(rng, 6), rng.normal(size=(6, 4))
    L, white = np.tril(A), X.copy()
    factor(L)
    solve_lower(L, white)
    np.testing.assert_allclose(L, np.linalg.cholesky(A), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(L @ white, X, rtol=1e-9, atol=1e-12)


def test_eigenvalues_and_axes(rng: np.random.Generator) -> None:
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for spread in ([3.0, 1.0, 2.0], [1e4, 1e-4, 1.0], [2.0, 2.0, 2.0], [0.0, 1.0, 0.0]):
        C = turned @ np.diag(spread) @ turned.T
        values, axes = np.empty(3), np.empty((3, 3))
        eigen_symmetric(C, values, axes)
        np.testing.assert_allclose(values, np.sort(spread), rtol=1e-9, atol=1e-11 * max(spread))
        np.testing.assert_allclose(axes @ np.diag(values) @ axes.T, C, atol=1e-11 * max(spread))
        np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
