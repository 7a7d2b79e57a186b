"""Representations of landmarks, and the arithmetic of sets of them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray
from ovmot.vio.landmarks import NO_ANCHOR, REPRESENTATIONS, Landmarks, no_landmarks

Derivative = Callable[..., FloatArray]
every_representation = pytest.mark.parametrize("name", list(REPRESENTATIONS))


def some_landmarks(name: str, n: int) -> Landmarks:
    rng = np.random.default_rng(3)
    ids = np.arange(n, dtype=np.int64)
    value = rng.uniform(0.1, 2.0, (n, 3))
    return replace(
        no_landmarks(name), feature_id=ids, value=value, first=value + 0.1,
        anchor_ns=np.full(n, NO_ANCHOR), rejections=ids % 3,
    )  # fmt: skip


@every_representation
def test_coordinates_come_back(name: str, central_differences: Derivative) -> None:
    coordinates = REPRESENTATIONS[name].coordinates
    points = np.random.default_rng(1).uniform([-4.0, -3.0, 2.0], [4.0, 3.0, 20.0], (20, 3))
    values = coordinates.from_point(points)
    np.testing.assert_allclose(coordinates.to_point(values), points, atol=1e-12)
    for value in values:
        J = central_differences(coordinates.to_point, value)
        np.testing.assert_allclose(coordinates.jacobian(value), J, rtol=1e-6, atol=1e-5)


@every_representation
def test_minus_undoes_plus_and_first_estimates_stay(name: str) -> None:
    landmarks = some_landmarks(name, 5)
    error = np.random.default_rng(4).normal(0.0, 0.1, 5 * landmarks.size)
    moved = landmarks.plus(error)
    np.testing.assert_allclose(moved.minus(landmarks), error, atol=1e-12)
    np.testing.assert_array_equal(moved.first, landmarks.first)
    # of a single inverse depth the bearing stays
    np.testing.assert_array_equal(
        moved.value[:, : 3 - landmarks.size], landmarks.value[:, : 3 - landmarks.size]
    )
    none = no_landmarks(name)
    assert none.plus(np.empty(0)) is none


def test_append_puts_others_after_those_kept() -> None:
    landmarks = some_landmarks("anchored_xyz", 5)
    some, others = landmarks.rows(landmarks.feature_id % 2 == 0), landmarks.rows(np.array([3, 1]))
    both = some.append(others)
    assert both.feature_id.tolist() == [0, 2, 4, 3, 1]
    for field in ("value", "first", "anchor_ns", "rejections"):
        np.testing.assert_array_equal(
            getattr(both, field), getattr(landmarks, field)[both.feature_id]
        )
