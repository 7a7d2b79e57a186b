"""The compiled sums of the motion between two stereo views against plain NumPy."""

from dataclasses import dataclass

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.stereo_motion_kernel import (
    count_inliers_compiled,
    motion_and_points_system_compiled,
    motion_system_compiled,
)
from ovmot.geometry.triangulation import inverse_3x3, project_normalized, project_stereo

T_CAM1_CAM0 = se3.make(so3.exp(np.array([0.02, -0.03, 0.2])), np.array([-0.4, 0.05, 0.02]))
SIGMA = np.array([1.0, 1.1, 0.9, 1.2]) / 800.0
HUBER, BOUND = 2.0, 30.0


@dataclass(frozen=True, slots=True)
class Pairs:
    """Points (N, 3) before, moved by T, seen with noise before and now (N, 4), some on a car."""

    T: FloatArray
    p: FloatArray
    before: FloatArray
    now: FloatArray
    W: FloatArray


@pytest.fixture
def pairs() -> Pairs:
    rng = np.random.default_rng(0)
    n = 60
    T = se3.exp(np.array([0.02, -0.05, 0.01, 0.1, -0.05, -0.6]))
    depth = rng.uniform(4.0, 30.0, (n, 1))
    p = np.concatenate([rng.uniform(-0.6, 0.6, (n, 2)), np.ones((n, 1))], axis=1) * depth
    q = se3.apply(T, p)
    q[:15] += np.array([0.9, 0.0, 0.8])
    views = [project_stereo(x, T_CAM1_CAM0)[0] + rng.normal(0.0, SIGMA, (n, 4)) for x in (p, q)]
    root = rng.normal(size=(n, 4, 4))
    S = 1e-2 * root @ np.swapaxes(root, -1, -2) + 25.0 * np.diag(SIGMA**2)
    return Pairs(T, p, views[0], views[1], np.asarray(np.linalg.inv(S), np.float64))


def plain_counts(
    pairs: Pairs, rotated: FloatArray, proposals: FloatArray, bound: float
) -> FloatArray:
    r = pairs.now - project_stereo(rotated + proposals[:, None], T_CAM1_CAM0)[0]
    inlier = np.einsum("hni,nij,hnj->hn", r, pairs.W, r) < bound
    return np.asarray(inlier.sum(1))


def plain_motion_system(pairs: Pairs) -> tuple[FloatArray, FloatArray]:
    rotated = pairs.p @ pairs.T[:3, :3].T
    h, J_point = project_stereo(rotated + pairs.T[:3, 3], T_CAM1_CAM0)
    r = pairs.now - h
    distance = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", r, pairs.W, r), 1e-12))
    weight = np.where(distance**2 < BOUND, np.minimum(1.0, HUBER / distance), 0.0)
    J = np.concatenate([J_point @ -so3.hat(rotated), J_point], axis=2)
    JtW = np.swapaxes(J, -1, -2) @ (pairs.W * weight[:, None, None])
    return (JtW @ J).sum(0), (JtW @ r[..., None]).sum(0)[:, 0]


def plain_residuals(
    point: FloatArray, T: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened residuals (N, 4, 1), Jacobians by point (N, 4, 3) and motion (N, 4, 6)."""
    inverse_depth = point[:, 2:]
    rotated = np.concatenate([point[:, :2], np.ones_like(inverse_depth)], axis=1) @ T[:3, :3].T
    q = rotated + inverse_depth * T[:3, 3]
    R, t = T_CAM1_CAM0[:3, :3], T_CAM1_CAM0[:3, 3]
    h0, J0 = project_normalized(q)
    h1, J1 = project_normalized(q @ R.T + inverse_depth * t)
    by_q = np.concatenate([J0, J1 @ R], axis=1) / SIGMA[:, None]
    by_depth = by_q @ T[:3, 3:]
    by_depth[:, 2:] += (J1 @ t[:, None]) / SIGMA[2:, None]
    by_point = np.concatenate([by_q @ T[:3, :2], by_depth], axis=2)
    by_motion = np.concatenate([by_q @ -so3.hat(rotated), by_q * inverse_depth[..., None]], axis=2)
    return ((z - np.concatenate([h0, h1], axis=1)) / SIGMA)[..., None], by_point, by_motion


def plain_motion_and_points_system(pairs: Pairs, point: FloatArray) -> tuple[FloatArray, ...]:
    r0, A0, _ = plain_residuals(point, np.eye(4), pairs.before)
    r1, A1, J = plain_residuals(point, pairs.T, pairs.now)
    A, r = np.concatenate([A0, A1], axis=1), np.concatenate([r0, r1], axis=1)
    At = np.swapaxes(A, -1, -2)
    N_inverse, g = inverse_3x3(At @ A), At @ r
    squared = (r * r).sum((1, 2)) - (np.swapaxes(g, -1, -2) @ N_inverse @ g)[:, 0, 0]
    distance = np.sqrt(np.maximum(squared, 1e-12))
    inlier = distance**2 < BOUND
    weight = np.where(inlier, np.minimum(1.0, HUBER / distance), 0.0)[:, None, None]
    Jt, cross = np.swapaxes(J, -1, -2), np.swapaxes(A1, -1, -2) @ J
    K = np.swapaxes(cross, -1, -2) @ N_inverse
    information = (weight * (Jt @ J - K @ cross)).sum(0)
    gradient = (weight * (Jt @ r1 - K @ g)).sum(0)[:, 0]
    return information, gradient, inlier, (N_inverse @ g)[..., 0], N_inverse @ cross


def test_inliers_of_each_proposal(pairs: Pairs) -> None:
    rotated = pairs.p @ pairs.T[:3, :3].T
    proposals = pairs.T[:3, 3] + np.random.default_rng(1).normal(0.0, 0.05, (10, 3))
    counts = count_inliers_compiled(proposals, rotated, pairs.now, pairs.W, T_CAM1_CAM0, BOUND)
    np.testing.assert_array_equal(counts, plain_counts(pairs, rotated, proposals, BOUND))
    assert 0 < counts.min() < counts.max() < len(rotated)


def test_system_of_the_motion(pairs: Pairs) -> None:
    found = motion_system_compiled(pairs.T, pairs.p, pairs.now, pairs.W, T_CAM1_CAM0, BOUND, HUBER)
    for got, wanted in zip(found, plain_motion_system(pairs), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_system_of_motion_and_points(pairs: Pairs) -> None:
    point = np.concatenate([pairs.before[:, :2], 1.0 / pairs.p[:, 2:]], axis=1)
    point[-3:, 2] = [1e-9, 1e-6, 1e-4]  # almost at infinity
    found = motion_and_points_system_compiled(
        pairs.T, point, pairs.before, pairs.now, SIGMA, T_CAM1_CAM0, BOUND, HUBER
    )
    wanted = plain_motion_and_points_system(pairs, point)
    np.testing.assert_array_equal(found[2], wanted[2])
    assert 0 < found[2].sum() < len(point)
    for k in (0, 1, 3, 4):
        scale = np.abs(wanted[k]).max()
        np.testing.assert_allclose(found[k], wanted[k], rtol=1e-8, atol=1e-9 * scale)
