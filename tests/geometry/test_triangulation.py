"""Points from two and from many views: exact without noise, and as scattered as claimed with it."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import (
    inverse_3x3,
    project_normalized,
    project_stereo,
    squared_distance,
    stereo_covariance,
    triangulate_many_views,
    triangulate_stereo,
)

Derivative = Callable[..., FloatArray]

RECTIFIED = se3.make(np.eye(3), np.array([-0.4, 0.0, 0.0]))
ROTATED = se3.make(so3.exp(np.array([0.1, -0.2, 0.6])), np.array([-0.3, 0.15, 0.08]))
rigs = pytest.mark.parametrize("T_cam1_cam0", [RECTIFIED, ROTATED], ids=["rectified", "rotated"])
SIGMA = np.array([2e-3, 2.5e-3, 1.5e-3, 2e-3])


def points_ahead(shape: tuple[int, ...], far: float = 40.0) -> FloatArray:
    rng = np.random.default_rng(3)
    depth = rng.uniform(2.0, far, (*shape, 1))
    return np.concatenate([rng.uniform(-0.5, 0.5, (*shape, 2)), np.ones((*shape, 1))], -1) * depth


@rigs
@pytest.mark.parametrize("shape", [(), (7,), (2, 5)])
def test_stereo_is_exact_without_noise(T_cam1_cam0: FloatArray, shape: tuple[int, ...]) -> None:
    p = points_ahead(shape)
    seen, _ = project_stereo(p, T_cam1_cam0)
    np.testing.assert_allclose(triangulate_stereo(seen, T_cam1_cam0), p, rtol=1e-9)


@rigs
def test_stereo_keeps_the_left_ray(T_cam1_cam0: FloatArray) -> None:
    seen, _ = project_stereo(points_ahead((50,), far=8.0), T_cam1_cam0)
    seen = seen + np.random.default_rng(0).normal(0.0, 1e-3, seen.shape)
    p = triangulate_stereo(seen, T_cam1_cam0)
    np.testing.assert_allclose(p[:, :2] / p[:, 2:], seen[:, :2], atol=1e-12)


def test_stereo_is_nan_where_a_half_is_missing() -> None:
    seen, _ = project_stereo(points_ahead((4,)), ROTATED)
    seen[0, 2:] = np.nan
    seen[1, :2] = np.nan
    seen[2, 3] = np.nan
    found = np.isfinite(triangulate_stereo(seen, ROTATED))
    np.testing.assert_array_equal(
        found, np.array([[False], [False], [False], [True]]) & np.ones(3, bool)
    )


def test_stereo_is_nan_behind_either_camera_and_at_infinity() -> None:
    behind_both, _ = project_stereo(np.array([0.5, 0.2, -4.0]), RECTIFIED)
    assert np.isnan(triangulate_stereo(behind_both, RECTIFIED)).all()
    # the right camera stands 2 m ahead, the point is 1 m ahead of the left one
    ahead = se3.make(np.eye(3), np.array([-0.4, 0.0, -2.0]))
    behind_right, _ = project_stereo(np.array([0.1, 0.2, 1.0]), ahead)
    assert np.isnan(triangulate_stereo(behind_right, ahead)).all()
    assert np.isnan(triangulate_stereo(np.array([0.1, 0.2, 0.1, 0.2]), RECTIFIED)).all()


@rigs
def test_projection_jacobian(T_cam1_cam0: FloatArray, central_differences: Derivative) -> None:
    for p in points_ahead((6,), far=15.0):
        expected = central_differences(lambda x: project_stereo(x, T_cam1_cam0)[0], p)
        np.testing.assert_allclose(project_stereo(p, T_cam1_cam0)[1], expected, atol=1e-8)


@rigs
def test_stereo_covariance_follows_the_derivative(
    T_cam1_cam0: FloatArray, central_differences: Derivative
) -> None:
    points = points_ahead((6,), far=15.0)
    claimed = stereo_covariance(points, T_cam1_cam0, SIGMA)
    for p, C in zip(points, claimed, strict=True):
        seen, _ = project_stereo(p, T_cam1_cam0)
        G = central_differences(lambda z: triangulate_stereo(z, T_cam1_cam0), seen)
        np.testing.assert_allclose(C, G @ np.diag(SIGMA**2) @ G.T, rtol=1e-5, atol=1e-12)


@rigs
def test_stereo_covariance_is_the_scatter(T_cam1_cam0: FloatArray) -> None:
    p, sigma = np.array([0.6, -0.4, 5.0]), 0.3 * SIGMA
    clean, _ = project_stereo(p, T_cam1_cam0)
    seen = clean + np.random.default_rng(5).normal(0.0, sigma, (20_000, 4))
    scatter = np.cov(triangulate_stereo(seen, T_cam1_cam0).T)
    L = np.linalg.inv(np.linalg.cholesky(stereo_covariance(p, T_cam1_cam0, sigma)))
    np.testing.assert_allclose(L @ scatter @ L.T, np.eye(3), atol=0.05)


def test_stereo_covariance_of_no_point_is_nan() -> None:
    p = np.array([[np.nan] * 3, [0.1, 0.2, 4.0]])
    C = stereo_covariance(p, ROTATED, SIGMA)
    assert np.isnan(C[0]).all()
    assert np.linalg.eigvalsh(C[1]).min() > 0.0


@pytest.mark.parametrize("shape", [(), (5,), (3, 4)])
def test_inverse_3x3_is_that_of_numpy(shape: tuple[int, ...]) -> None:
    A = np.random.default_rng(1).normal(size=(*shape, 3, 3))
    scale = np.array([1e-3, 1.0, 1e4])
    A = A * scale[:, None] * scale
    np.testing.assert_allclose(inverse_3x3(A), np.linalg.inv(A), rtol=1e-8)


def test_squared_distances_are_those_of_a_solved_system() -> None:
    rng = np.random.default_rng(4)
    L, off = rng.normal(0.0, 1.0, (5, 7, 3, 3)), rng.normal(0.0, 1.0, (5, 7, 3))
    C = L @ np.swapaxes(L, -1, -2) + 0.1 * np.eye(3)
    expected = (off * np.linalg.solve(C, off[..., None])[..., 0]).sum(-1)
    np.testing.assert_allclose(squared_distance(off, C), expected, rtol=1e-8)


def test_inverse_3x3_of_a_singular_matrix_is_not_finite() -> None:
    good = np.diag([1.0, 2.0, 4.0])
    inverse = inverse_3x3(np.stack([np.diag([1.0, 1.0, 0.0]), good]))
    assert not np.isfinite(inverse[0]).any()
    np.testing.assert_allclose(inverse[1], np.diag([1.0, 0.5, 0.25]))


def camera_path(n: int = 8) -> FloatArray:
    """T_view_world (n, 4, 4): sideways steps of half a metre, with turns."""
    k = np.arange(n, dtype=np.float64)
    p = np.stack([0.5 * k, 0.1 * np.sin(k), 0.2 * k], axis=1)
    R = so3.exp(np.stack([0.03 * np.sin(k), 0.02 * k, 0.05 * np.cos(k)], axis=1))
    return se3.inverse(se3.make(R, p))


def views_of(p_world: FloatArray, T_view_world: FloatArray) -> FloatArray:
    """Plane coordinates (F, V, 2) of points (F, 3)."""
    return project_normalized(se3.apply(T_view_world[None], p_world[:, None]))[0]


@pytest.mark.parametrize("depth", [2.0, 10.0, 100.0])
def test_many_views_are_exact_without_noise(depth: float) -> None:
    T = camera_path()
    rng = np.random.default_rng(2)
    p = np.concatenate([rng.uniform(-0.3, 0.3, (20, 2)), np.ones((20, 1))], axis=1) * depth
    found = triangulate_many_views(views_of(p, T), T, 1e-3)
    assert found.valid.all()
    np.testing.assert_allclose(found.p_world, p, atol=1e-6 * depth)
    np.testing.assert_allclose(found.depth, se3.apply(T[0], p)[:, 2], rtol=1e-6)


def test_many_views_scatter_as_their_information_says() -> None:
    T, sigma, n = camera_path(), 1e-3, 3000
    p = np.array([0.8, -0.5, 8.0])
    _, J = project_normalized(se3.apply(T, p))
    J = J @ T[:, :3, :3]
    information = np.einsum("vij,vik->jk", J, J) / sigma**2
    clean = views_of(p[None], T)
    noisy = clean + np.random.default_rng(4).normal(0.0, sigma, (n, len(T), 2))
    found = triangulate_many_views(noisy, T, sigma)
    e = found.p_world - p
    nees = np.einsum("ni,ij,nj->n", e, information, e)
    assert found.valid.mean() > 0.999
    assert nees.mean() == pytest.approx(3.0, abs=0.2)


def test_many_views_take_any_subset_and_each_feature_alone() -> None:
    T = camera_path()
    p = points_ahead((12,), far=20.0)
    xy = views_of(p, T)
    rng = np.random.default_rng(8)
    xy = xy + rng.normal(0.0, 1e-4, xy.shape)
    xy[rng.random(xy.shape[:2]) < 0.5] = np.nan
    xy[:, [2, 5]] = views_of(p, T)[:, [2, 5]]
    together = triangulate_many_views(xy, T, 1e-3)
    assert together.valid.all()
    for i in range(len(p)):
        alone = triangulate_many_views(xy[i : i + 1], T, 1e-3)
        np.testing.assert_allclose(alone.p_world[0], together.p_world[i], rtol=1e-9)


def test_many_views_refuse_what_can_not_be_a_point() -> None:
    T, sigma = camera_path(), 1e-3
    p = np.tile([0.5, 0.3, 6.0], (7, 1))
    p[1] = [0.5, 0.3, -6.0]  # its images are those of a point behind
    p[5] = [3.0, 2.0, 300.0]
    p[6] = [0.01, 0.0, 0.3]
    xy = views_of(p, T)
    xy[2, 1:] = np.nan  # one view
    xy[3] = np.nan  # none
    xy[4, 3] += 0.2  # one observation of something else
    found = triangulate_many_views(xy, T, sigma, depth_range=(0.5, 200.0))
    expected = [True, False, False, False, False, False, False]
    np.testing.assert_array_equal(found.valid, expected)
    assert np.isfinite(found.p_world).all()
