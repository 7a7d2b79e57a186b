"""The compiled refinement of bodies around its normal equations, against plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_views_kernel import BodyViews
from ovmot.objects.refined_bodies_kernel import (
    RefinedBodies,
    StereoPixels,
    refine_bodies,
    refine_bodies_compiled,
    weighted_views,
    world_points,
)
from ovmot.objects.refinement_kernel import Refined, refine
from ovmot.physics import gates

T_CAM1_CAM0 = se3.make(np.eye(3), np.array([-0.5, 0.0, 0.0]))
PIXELS = StereoPixels(T_CAM1_CAM0, np.array([400.0, 410.0, 405.0, 415.0]), 0.7, 0.1, 0.02)
BODY = np.repeat([0, 1, 2], [3, 3, 2])


def covariances(rng: np.random.Generator, n: int) -> FloatArray:
    """Covariances (n, 3, 3)."""
    A = rng.normal(size=(n, 3, 3))
    return np.asarray(A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3))


@pytest.fixture
def views() -> BodyViews:
    """Three bodies at rest of 8 points, the last with little noise; in three views, the last of
    them from the world's origin."""
    rng = np.random.default_rng(3)
    p = rng.uniform([-2.0, -1.0, 8.0], [2.0, 1.0, 16.0], (8, 3))
    twist = 0.02 * rng.normal(size=(3, 3, 6)) * np.array([1.0, 0.5, 0.0])[:, None, None]
    T = se3.exp(twist)
    q = se3.apply(se3.inverse(T)[:, BODY], p)
    right = se3.apply(T_CAM1_CAM0, q)
    seen = np.concatenate([q[..., :2] / q[..., 2:], right[..., :2] / right[..., 2:]], axis=-1)
    seen += rng.normal(0.0, 1.0, seen.shape) * np.where(BODY < 2, 3e-3, 5e-4)[:, None]
    seen[0, 2], seen[1, 5, 2] = np.nan, np.nan
    span = np.repeat(np.array([[0.8], [0.4], [0.0]]), 3, axis=1)
    origin = np.stack([p[b == BODY].mean(axis=0) for b in range(3)])
    length = rng.uniform(0.0, 9.0, (3, 3))
    return BodyViews(seen, p, BODY, T, span, length, origin, 0.1 * rng.normal(size=(3, 6)))


def test_weights_of_views(views: BodyViews) -> None:
    weighted, seen = weighted_views(views, PIXELS), views.seen
    valid = np.isfinite(seen).all(-1)
    flow = np.nan_to_num(np.linalg.norm((seen - seen[-1])[..., :2] * PIXELS.focal[:2], axis=-1))
    drift = views.track_length[:, BODY] * 0.1**2 + (0.02 * flow) ** 2
    half = np.sqrt(0.5)
    np.testing.assert_allclose(weighted.by_difference, np.where(valid, half / 0.7, 0.0), rtol=1e-14)
    expected = np.where(valid, half / np.sqrt(0.7**2 + 2.0 * drift), 0.0)
    np.testing.assert_allclose(weighted.by_sum, expected, rtol=1e-13)
    out_of = se3.make(np.eye(3), -views.origin) @ views.T_world_cam0
    np.testing.assert_allclose(weighted.into_view, se3.inverse(out_of), atol=1e-13)
    np.testing.assert_allclose(weighted.out_of_now, out_of[-1], atol=1e-13)


def test_points_in_world(views: BodyViews) -> None:
    rng = np.random.default_rng(4)
    T = se3.exp(rng.normal(size=(3, 6)))
    point, N_inverse = rng.uniform(0.1, 0.5, (8, 3)), covariances(rng, 8)
    K = rng.normal(size=(8, 6, 3))
    z = 1.0 / point[:, 2]
    ray = np.column_stack([point[:, :2], np.ones(8)])
    J = np.zeros((8, 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = z
    J[:, :, 2] = -ray * z[:, None] ** 2
    J = T[BODY][:, :3, :3] @ J
    none, ones = np.zeros((3, 6)), np.ones(8)
    found = Refined(
        point, none, np.zeros((3, 6, 6)), ones, ones, np.ones(8, np.bool_), N_inverse, K
    )
    seen_from = views._replace(T_world_cam0=np.stack([views.T_world_cam0[0], T]))
    p, C, by_twist = world_points(found, seen_from._replace(seen=views.seen[:2]))
    np.testing.assert_allclose(p, se3.apply(T[BODY], ray * z[:, None]), atol=1e-13)
    np.testing.assert_allclose(C, J @ N_inverse @ J.swapaxes(-1, -2), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(by_twist, -J @ K.swapaxes(-1, -2), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("kernel", [refine_bodies, refine_bodies_compiled])
def test_bodies_are_refined_with_gates_and_priors(
    views: BodyViews, kernel: Callable[..., RefinedBodies]
) -> None:
    """Noise above the prior one widens the covariance of a body."""
    may_turn = np.array([True, False, True])
    huber, bound = gates(9, 0.9), gates(9, 0.999)
    found = kernel(views, may_turn, PIXELS, 0.4, 0.03, huber, bound)
    weighted, z = weighted_views(views, PIXELS), views.p_cam0[:, 2:]
    point = np.column_stack([views.p_cam0[:, :2], np.ones(8)]) / z
    prior = np.zeros((3, 6))
    prior[:, :3] = 0.03**-2
    prior[may_turn, 2] = 0.4**-2
    dof = 4 * np.isfinite(views.seen).all(-1).sum(0) - 3
    plain = refine(point, views.twist, weighted, np.sqrt(huber[dof]), bound[dof], prior)
    np.testing.assert_allclose(found.twist, plain.twist, rtol=1e-7, atol=1e-10)
    np.testing.assert_array_equal(found.inlier, plain.inlier)
    cost = np.bincount(BODY, plain.weight * plain.cost, 3)
    body_dof = np.bincount(BODY, np.where(plain.inlier, dof, 0.0), 3)
    widen = np.maximum(1.0, cost / np.maximum(body_dof, 1.0))
    expected = np.linalg.inv(plain.information) * widen[:, None, None]
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.p_world, world_points(plain, views)[0], rtol=1e-8, atol=1e-10)
    assert (widen > 1.0).any() and (cost < body_dof).any()
