"""The compiled normal equations equal their plain NumPy twin, and their derivatives are right."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.refinement_kernel import (
    WeightedViews,
    reduce_points,
    refine,
    through_body,
    view_rows,
)

TWIST = np.array([[0.02, -0.05, 0.4, 4.0, -1.0, 0.1], [0.02, -0.01, -2.3, -8.0, 0.5, 0.0]])
N = 8


def rotated(twist: FloatArray) -> FloatArray:
    return se3.exp(np.asarray(twist))


@pytest.fixture(scope="module")
def seen(rig: StereoRig) -> tuple[FloatArray, WeightedViews]:
    """Points (M, 3) of two bodies, off where three noisy views see them."""
    rng = np.random.default_rng(6)
    body = np.repeat([0, 1], N)
    span = np.array([[1.0, 0.7], [0.5, 0.7], [0.0, 0.0]])
    # a camera that looks along the world's x, the bodies 15 m ahead of it
    R = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T = se3.make(R, np.zeros(3)) @ rotated(rng.normal(0.0, 0.03, (3, 2, 6)))
    T[..., :3, 3] -= [15.0, 0.0, 0.0]
    into_view = se3.inverse(T)
    D = rng.uniform(-1.5, 1.5, (2 * N, 3))
    p_now = se3.apply(into_view[-1, body], D)
    q = se3.apply((into_view @ rotated(-span[..., None] * TWIST))[:, body], D)
    uv = project_stereo(q, rig.T_cam1_cam0)[0] + rng.normal(0.0, 1e-3, (3, 2 * N, 4))
    exists = np.ones((3, 2 * N))
    exists[1, 3] = 0.0
    uv[1, 3] = np.nan
    weight = rng.uniform(1.0, 3.0, (2, 3, 2 * N)) * exists
    point = np.column_stack([p_now[:, :2], np.ones(2 * N)]) / p_now[:, 2:]
    point += rng.normal(0.0, 1e-3, point.shape)
    focal = np.array([700.0, 710.0, 705.0, 715.0])
    return point, WeightedViews(
        uv, weight[0], weight[1], body, span, into_view, T[-1].copy(),
        np.ascontiguousarray(rig.T_cam1_cam0), focal,
    )  # fmt: skip


def rows_of(point: FloatArray, twist: FloatArray, s: WeightedViews, v: int, n: int) -> FloatArray:
    """The kernel's rows (4, 10) of one view of a point."""
    b = s.body[n]
    C, J, rows = np.empty((3, 4)), np.empty((6, 3)), np.empty((4, 10))
    through_body(s.span_s[v, b] * twist[b], s.into_view[v, b], C, J)
    view_rows(point[n], C, J, s.span_s[v, b], v, n, s, np.empty((3, 10)), rows)
    return rows


def residual(point: FloatArray, twist: FloatArray, s: WeightedViews, v: int, n: int) -> FloatArray:
    """In standard deviations (4,), by the exponential itself."""
    b = s.body[n]
    T = s.into_view[v, b] @ se3.exp(-s.span_s[v, b] * twist[b]) @ s.out_of_now[b]
    p = np.append(point[n, :2], 1.0) / point[n, 2]
    off = (s.seen[v, n] - project_stereo(se3.apply(T, p), s.T_cam1_cam0)[0]) * s.focal
    difference, total = off[:2] - off[2:], off[:2] + off[2:]
    return np.append(difference * s.by_difference[v, n], total * s.by_sum[v, n])


@pytest.mark.parametrize(("v", "n"), [(0, 0), (0, N), (1, 1), (1, N + 2), (2, 4)])
def test_derivatives_are_those_of_finite_differences(
    seen: tuple[FloatArray, WeightedViews], v: int, n: int
) -> None:
    point, s = seen
    rows = rows_of(point, TWIST, s, v, n)
    np.testing.assert_allclose(rows[:, 9], residual(point, TWIST, s, v, n), atol=1e-9)
    step = 1e-6
    for k in range(3):
        d = step * np.eye(3)[k]
        apart = residual(point - d, TWIST, s, v, n) - residual(point + d, TWIST, s, v, n)
        np.testing.assert_allclose(rows[:, k], apart / (2.0 * step), rtol=1e-5, atol=1e-3)
    for k in range(6):
        d = step * np.eye(6)[k]
        apart = residual(point, TWIST - d, s, v, n) - residual(point, TWIST + d, s, v, n)
        np.testing.assert_allclose(rows[:, 3 + k], apart / (2.0 * step), rtol=1e-5, atol=1e-4)


def test_points_are_eliminated_as_in_the_twin(seen: tuple[FloatArray, WeightedViews]) -> None:
    point, s = seen
    huber, bound = np.full(2 * N, 2.0), np.full(2 * N, 30.0)
    bound[5] = 0.0
    out = reduce_points(point, TWIST, s, huber, 0.5 * bound, 2.0)
    assert not out.inlier[5] and (out.weight[out.inlier] < 1.0).any()
    information, gradient = np.zeros((2, 6, 6)), np.zeros((2, 6))
    for n in range(2 * N):
        views = [v for v in range(3) if s.by_sum[v, n] > 0.0]
        rows = np.concatenate([rows_of(point, TWIST, s, v, n) for v in views])
        A, J, r = rows[:, :3], rows[:, 3:9], rows[:, 9]
        N_inverse = np.linalg.inv(A.T @ A)
        left = r - A @ N_inverse @ A.T @ r
        K = J.T @ A @ N_inverse
        np.testing.assert_allclose(out.N_inverse[n], N_inverse, rtol=1e-6, atol=1e-14)
        np.testing.assert_allclose(out.step[n], N_inverse @ A.T @ r, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(out.K[n], K, rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(out.cost[n], left @ left, rtol=1e-6, atol=1e-9)
        if left @ left < bound[n]:
            w = min(1.0, huber[n] / np.sqrt(left @ left))
            information[s.body[n]] += w * (J.T @ J - K @ A.T @ J)
            gradient[s.body[n]] += w * (J.T @ r - K @ A.T @ r)
    np.testing.assert_allclose(out.information, information, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(out.gradient, gradient, rtol=1e-6, atol=1e-5)


def test_the_iterations_are_those_of_the_twin(seen: tuple[FloatArray, WeightedViews]) -> None:
    """Six steps of Gauss-Newton at most, the first two with a wide bound for outliers."""
    start, s = seen
    twist, body = TWIST + 0.05, s.body
    huber, bound, prior = np.full(2 * N, 2.0), np.full(2 * N, 90.0), np.full((2, 6), 0.5)
    found = refine(start, twist, s, huber, bound, prior)
    point = start.copy()
    for iteration in range(6):
        wide = iteration < 2
        reduced = reduce_points(point, twist, s, huber, bound, 9.0 if wide else 1.0)
        information = reduced.information + np.eye(6) * (prior[:, None] + 1e-6)
        gradient = reduced.gradient - prior * twist
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        by_point = reduced.step - np.einsum("mi,mij->mj", step[body], reduced.K)
        by_point[:, 2] = np.clip(by_point[:, 2], -0.5 * point[:, 2], point[:, 2])
        point, twist = point + by_point, twist + step
        if not wide and (step * gradient).sum(1).max() < 0.02:
            break
    np.testing.assert_allclose(found.twist, twist, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.point, point, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.information, information, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.inlier, reduced.inlier)
    assert found.inlier.sum() > N
