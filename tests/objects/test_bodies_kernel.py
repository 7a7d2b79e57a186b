"""The compiled small questions about bodies against plain NumPy."""

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.bodies_kernel import (
    height_above_ground_compiled,
    least_distance_compiled,
    twists_about_compiled,
    velocity_distance_compiled,
    view_weights_compiled,
    world_points_compiled,
)


def covariances(rng: np.random.Generator, n: int) -> FloatArray:
    """Covariances (n, 3, 3)."""
    A = rng.normal(size=(n, 3, 3))
    return np.asarray(A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3))


def test_distances() -> None:
    rng = np.random.default_rng(1)
    v, C = rng.normal(size=3), covariances(rng, 1)[0]
    expected = v @ np.linalg.solve(C + 0.3**2 * np.eye(3), v)
    assert velocity_distance_compiled(v, C, 0.3) == pytest.approx(expected, rel=1e-12)
    p, q = rng.normal(size=(7, 3)), rng.normal(size=(9, 3)) + 3.0
    least = np.linalg.norm(p[:, None] - q[None], axis=-1).min()
    assert least_distance_compiled(p, q) == pytest.approx(least, rel=1e-14)


@pytest.mark.parametrize("n", [3, 25])
def test_height_above_the_ground(n: int) -> None:
    rng = np.random.default_rng(2)
    p, static = rng.normal(size=(n, 3)), 5.0 * rng.normal(size=(60, 3))
    off = static[:, :2] - p[:, :2].mean(axis=0)
    near = np.sort(static[(off**2).sum(axis=1) < 4.0**2, 2])
    expected = np.sort(p[:, 2])[-1 - n // 10] - near[len(near) // 10]
    found = height_above_ground_compiled(p, static, 4.0, len(near))
    assert found == pytest.approx(expected, rel=1e-14)
    assert height_above_ground_compiled(p, static, 4.0, len(near) + 1) == np.inf


def test_weights_of_views() -> None:
    rng = np.random.default_rng(3)
    seen, body = rng.normal(size=(3, 8, 4)), np.arange(8) // 3
    seen[0, 2], seen[1, 5, 2], seen[2, 7] = np.nan, np.nan, np.nan
    length, focal = rng.uniform(0.0, 9.0, (3, 3)), np.array([400.0, 410.0, 400.0, 410.0])
    valid = np.isfinite(seen).all(-1)
    flow = np.nan_to_num(np.linalg.norm((seen - seen[-1])[..., :2] * focal[:2], axis=-1))
    drift = length[:, body] * 0.1**2 + (0.02 * flow) ** 2
    difference, total, found = view_weights_compiled(seen, body, length, focal, 0.7, 0.1, 0.02)
    half = np.sqrt(0.5)
    np.testing.assert_array_equal(found, valid)
    np.testing.assert_allclose(difference, np.where(valid, half / 0.7, 0.0), rtol=1e-14)
    expected = np.where(valid, half / np.sqrt(0.7**2 + 2.0 * drift), 0.0)
    np.testing.assert_allclose(total, expected, rtol=1e-13)


def test_points_in_world() -> None:
    rng = np.random.default_rng(4)
    T, body = se3.exp(rng.normal(size=(2, 6))), np.array([0, 1, 1, 0, 1])
    point = rng.uniform(0.1, 0.5, (5, 3))
    N_inverse, K = covariances(rng, 5), rng.normal(size=(5, 6, 3))
    z = 1.0 / point[:, 2]
    ray = np.column_stack([point[:, :2], np.ones(5)])
    J = np.zeros((5, 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = z
    J[:, :, 2] = -ray * z[:, None] ** 2
    J = T[body][:, :3, :3] @ J
    p, C, by_twist = world_points_compiled(point, T, body, N_inverse, K)
    np.testing.assert_allclose(p, se3.apply(T[body], ray * z[:, None]), atol=1e-13)
    np.testing.assert_allclose(C, J @ N_inverse @ J.swapaxes(-1, -2), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(by_twist, -J @ K.swapaxes(-1, -2), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 5e-4, 0.3, 2.5])
def test_twists_about_the_bodies(angle: float) -> None:
    rng = np.random.default_rng(5)
    turn = rng.normal(size=(4, 3))
    turn *= angle / np.linalg.norm(turn, axis=1, keepdims=True)
    motions = se3.exp(np.hstack([turn, rng.normal(size=(4, 3))]))
    T, origin, span = se3.exp(rng.normal(size=6)), rng.normal(size=(4, 3)), rng.uniform(0.1, 1.0, 4)
    shift = se3.make(np.eye(3), origin)
    about = se3.inverse(shift) @ T @ motions @ se3.inverse(T) @ shift
    found = twists_about_compiled(motions, T, origin, span)
    np.testing.assert_allclose(found, se3.log(about) / span[:, None], rtol=1e-9, atol=1e-11)
