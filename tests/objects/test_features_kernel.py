"""The compiled loops over features equal their plain NumPy twins."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.features_kernel import (
    distance_from_box,
    distance_of_velocity,
    feature_motions,
    feature_motions_compiled,
    places_of_compiled,
)

N, ACCEL = 40, 1.5


def covariances(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    A = rng.normal(0.0, 0.3, (*shape, 3, 3))
    return A @ np.swapaxes(A, -1, -2)


@pytest.mark.parametrize("motions", [feature_motions, feature_motions_compiled])
def test_motions_are_since_the_best_time(motions: Callable[..., tuple[FloatArray, ...]]) -> None:
    """Of four rows two count; one is too old. Some features are new or were not seen then."""
    rng = np.random.default_rng(1)
    p_kept, cov_kept = rng.normal(size=(50, 4, 3)), covariances(rng, (50, 4))
    p_kept[rng.random((50, 4)) < 0.3] = np.nan
    p_cam0, cov_cam0 = rng.normal(size=(N, 3)), covariances(rng, (N,))
    p_cam0[3] = np.nan
    place, is_new = rng.permutation(50)[:N], rng.random(N) < 0.2
    rows, age_s = np.array([3, 0]), np.array([0.3, 0.0, 9.0, 0.6])
    T = se3.exp(rng.normal(0.0, 0.3, 6))
    then, cov_then = p_kept[place][:, rows], cov_kept[place][:, rows]
    then[is_new] = np.nan
    p, cov, velocity, velocity_cov, change = motions(
        p_cam0, cov_cam0, T, place, is_new, age_s, 1, 0.8, ACCEL, p_kept, cov_kept
    )
    np.testing.assert_allclose(p, se3.apply(T, p_cam0), rtol=1e-9)
    np.testing.assert_allclose(cov, T[:3, :3] @ cov_cam0 @ T[:3, :3].T, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(p_kept[place, 1], p)
    np.testing.assert_array_equal(cov_kept[place, 1], cov)
    ages = age_s[rows]
    spread = (cov[:, None] + cov_then) / ages[:, None, None] ** 2
    changed = (0.5 * ACCEL * ages) ** 2
    error = np.trace(spread, axis1=2, axis2=3) + 3.0 * changed
    error = np.where(np.isfinite(then[..., 0] + p[:, None, 0]), error, np.inf)
    best = np.argmin(error, axis=1)
    known = np.isfinite(error.min(1))
    assert 5 < known.sum() < N
    np.testing.assert_array_equal(np.isfinite(velocity[:, 0]), known)
    k = np.arange(N)
    v = (p - then[k, best]) / ages[best, None]
    np.testing.assert_allclose(velocity[known], v[known], rtol=1e-9)
    np.testing.assert_array_equal(change[known], changed[best[known]])
    C = spread[k, best] + changed[best, None, None] * np.eye(3)
    np.testing.assert_allclose(velocity_cov[known], C[known], rtol=1e-9)


def test_features_keep_their_places_and_new_ones_get_free_ones() -> None:
    ids, before, place_before = np.array([8, 3, 9, 4]), np.array([3, 5, 8]), np.array([2, 0, 1])
    place, is_new = places_of_compiled(ids, before, place_before, 5)
    assert place.tolist() == [1, 2, 0, 3]
    assert is_new.tolist() == [False, False, True, True]


def test_the_distance_of_a_velocity() -> None:
    rng = np.random.default_rng(2)
    v, C = rng.normal(size=(N, 3)), covariances(rng, (N,))
    body, P = np.array([1.0, -0.5, 0.2]), covariances(rng, ())
    found = np.array([distance_of_velocity(v[n], C[n], body, P, 0.2) for n in range(N)])
    wide = C + 0.04 * np.eye(3)
    np.testing.assert_allclose(found[:, 0], squared_distance(v, wide), rtol=1e-8)
    np.testing.assert_allclose(found[:, 1], squared_distance(v - body, wide + P), rtol=1e-8)
    np.testing.assert_allclose(found[:, 2], np.linalg.norm(v - body, axis=1), rtol=1e-8)
    unknown = distance_of_velocity(np.full(3, np.nan), C[0], body, P, 0.2)
    assert np.isinf(unknown).all()


def test_the_distance_from_a_box() -> None:
    rng = np.random.default_rng(3)
    centre, size, yaw = rng.uniform(-2.0, 2.0, 3), rng.uniform(1.0, 5.0, 3), 0.7
    for p in rng.uniform(-6.0, 6.0, (50, 3)):
        outside = np.maximum(np.abs((p - centre) @ rotation_z(yaw)) - 0.5 * size, 0.0)
        found = distance_from_box(p, centre, size, yaw)
        assert found == pytest.approx(np.linalg.norm(outside), abs=1e-9)
    assert np.isinf(distance_from_box(np.full(3, np.nan), centre, size, yaw))
