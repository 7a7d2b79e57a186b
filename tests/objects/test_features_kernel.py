"""The compiled loops over features equal their plain NumPy twins."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.features_kernel import (
    distances_of_velocities,
    distances_of_velocities_compiled,
    feature_motions,
    feature_motions_compiled,
    points_near_boxes,
    points_near_boxes_compiled,
)

N, ACCEL = 40, 1.5


def covariances(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    A = rng.normal(0.0, 0.3, (*shape, 3, 3))
    return A @ np.swapaxes(A, -1, -2)


@pytest.mark.parametrize("motions", [feature_motions, feature_motions_compiled])
def test_motions_are_since_the_best_time(motions: Callable[..., tuple[FloatArray, ...]]) -> None:
    """Of four rows three count, in turn; some features are new or were not seen at some time."""
    rng = np.random.default_rng(1)
    p_kept, cov_kept = rng.normal(size=(50, 4, 3)), covariances(rng, (50, 4))
    p_kept[rng.random((50, 4)) < 0.3] = np.nan
    p_cam0, cov_cam0 = rng.normal(size=(N, 3)), covariances(rng, (N,))
    p_cam0[3] = np.nan
    place, is_new = rng.permutation(50)[:N], rng.random(N) < 0.2
    rows, age_s = np.array([3, 0, 1]), np.array([0.6, 0.3, 0.0])
    T = se3.exp(rng.normal(0.0, 0.3, 6))
    then, cov_then = p_kept[place][:, rows[:2]], cov_kept[place][:, rows[:2]]
    then[is_new] = np.nan
    p, cov, velocity, velocity_cov, change = motions(
        p_cam0, cov_cam0, T, place, is_new, rows, age_s, ACCEL, p_kept, cov_kept
    )
    np.testing.assert_allclose(p, se3.apply(T, p_cam0), rtol=1e-9)
    np.testing.assert_allclose(cov, T[:3, :3] @ cov_cam0 @ T[:3, :3].T, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(p_kept[place, 1], p)
    np.testing.assert_array_equal(cov_kept[place, 1], cov)
    spread = (cov[:, None] + cov_then) / age_s[:2, None, None] ** 2
    changed = (0.5 * ACCEL * age_s[:2]) ** 2
    error = np.trace(spread, axis1=2, axis2=3) + 3.0 * changed
    error = np.where(np.isfinite(then[..., 0] + p[:, None, 0]), error, np.inf)
    best = np.argmin(error, axis=1)
    known = np.isfinite(error.min(1))
    assert 5 < known.sum() < N
    np.testing.assert_array_equal(np.isfinite(velocity[:, 0]), known)
    k = np.arange(N)
    v = (p - then[k, best]) / age_s[best, None]
    np.testing.assert_allclose(velocity[known], v[known], rtol=1e-9)
    np.testing.assert_array_equal(change[known], changed[best[known]])
    C = spread[k, best] + changed[best, None, None] * np.eye(3)
    np.testing.assert_allclose(velocity_cov[known], C[known], rtol=1e-9)


@pytest.mark.parametrize("distances", [distances_of_velocities, distances_of_velocities_compiled])
def test_distances_of_velocities(distances: Callable[..., tuple[FloatArray, ...]]) -> None:
    rng = np.random.default_rng(2)
    v, C = rng.normal(size=(N, 3)), covariances(rng, (N,))
    v[7] = np.nan
    chosen, body, P = rng.random(N) < 0.7, np.array([1.0, -0.5, 0.2]), covariances(rng, ())
    from_rest, from_body, off = distances(v, C, chosen, body, P, 0.2)
    wide = C + 0.04 * np.eye(3)
    known = chosen & np.isfinite(v[:, 0])
    for found, expected in (
        (from_rest, squared_distance(v, wide)),
        (from_body, squared_distance(v - body, wide + P)),
        (off, np.linalg.norm(v - body, axis=1)),
    ):
        np.testing.assert_allclose(found, np.where(known, expected, np.inf), rtol=1e-8)


@pytest.mark.parametrize("near_boxes", [points_near_boxes, points_near_boxes_compiled])
def test_points_near_boxes(near_boxes: Callable[..., BoolArray]) -> None:
    rng = np.random.default_rng(3)
    p, cov = rng.uniform(-6.0, 6.0, (200, 3)), 0.2 * covariances(rng, (200,))
    p[5] = np.nan
    centre, size = rng.uniform(-2.0, 2.0, (3, 3)), rng.uniform(1.0, 5.0, (3, 3))
    yaw, variance = rng.uniform(-3.0, 3.0, 3), rng.uniform(0.0, 0.5, 3)
    found = near_boxes(p, cov, centre, size, yaw, variance, 0.5, 2.0)
    for t in range(3):
        local = (p - centre[t]) @ se3.exp(np.r_[0.0, 0.0, yaw[t], np.zeros(3)])[:3, :3]
        outside = np.maximum(np.abs(local) - 0.5 * size[t], 0.0)
        reach = 0.5 + 2.0 * np.sqrt(np.trace(cov, axis1=1, axis2=2) + variance[t])
        with np.errstate(invalid="ignore"):
            expected = np.linalg.norm(outside, axis=1) < reach
        np.testing.assert_array_equal(found[t], expected)
    assert 20 < found.sum() < 580
