"""The compiled normal equations of a stereo motion against their plain NumPy twins."""

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import AnyArray, FloatArray
from ovmot.geometry.stereo_motion_kernel import (
    motion_and_point_equations_compiled,
    motion_equations_compiled,
)
from ovmot.geometry.triangulation import inverse_3x3, project_normalized, project_stereo

T_C1_C0 = se3.make(so3.exp(np.array([0.01, 0.02, -0.01])), np.array([-0.3, 0.01, 0.02]))
T = se3.make(so3.exp(np.array([0.01, -0.02, 0.005])), np.array([0.1, 0.02, -0.4]))
SIGMA = np.array([0.001, 0.0012, 0.001, 0.0011])
BOUND, HUBER = 20.0, 2.0


def scene() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (N, 3), and their views before and after the motion; some are mismatched, one is not
    seen."""
    rng = np.random.default_rng(0)
    z = rng.uniform(4.0, 30.0, 40)
    p = np.column_stack([rng.uniform(-0.5, 0.5, 40) * z, rng.uniform(-0.3, 0.3, 40) * z, z])
    before, now = project_stereo(p, T_C1_C0)[0], project_stereo(se3.apply(T, p), T_C1_C0)[0]
    before += SIGMA * rng.standard_normal((40, 4))
    now += 1.5 * SIGMA * rng.standard_normal((40, 4))
    now[::9] += 0.05
    now[5] = np.nan
    return p, before, now


def weights(square: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        huber = np.minimum(1.0, HUBER / np.sqrt(np.maximum(square, 1e-12)))
        return np.where(square < BOUND, huber, 0.0)


def residuals(point: FloatArray, T: FloatArray, z: FloatArray) -> tuple[FloatArray, ...]:
    """Whitened residuals (N, 4, 1), derivatives by points (N, 4, 3) and by the motion (N, 4, 6)."""
    rho = point[:, 2:]
    rotated = np.concatenate([point[:, :2], np.ones_like(rho)], axis=1) @ T[:3, :3].T
    q = rotated + rho * T[:3, 3]
    h0, J0 = project_normalized(q)
    h1, J1 = project_normalized(q @ T_C1_C0[:3, :3].T + rho * T_C1_C0[:3, 3])
    by_q = np.concatenate([J0, J1 @ T_C1_C0[:3, :3]], axis=1) / SIGMA[:, None]
    by_depth = by_q @ T[:3, 3:]
    by_depth[:, 2:] += (J1 @ T_C1_C0[:3, 3:]) / SIGMA[2:, None]
    by_point = np.concatenate([by_q @ T[:3, :2], by_depth], axis=2)
    by_motion = np.concatenate([by_q @ -so3.hat(rotated), by_q * rho[..., None]], axis=2)
    return ((z - np.concatenate([h0, h1], axis=1)) / SIGMA)[..., None], by_point, by_motion


def with_points(point: FloatArray, before: FloatArray, now: FloatArray) -> tuple[AnyArray, ...]:
    r0, A0, _ = residuals(point, np.eye(4), before)
    r1, A1, J = residuals(point, T, now)
    A, r = np.concatenate([A0, A1], axis=1), np.concatenate([r0, r1], axis=1)
    inverse, g = inverse_3x3(np.swapaxes(A, 1, 2) @ A), np.swapaxes(A, 1, 2) @ r
    square = (r * r).sum((1, 2)) - (np.swapaxes(g, 1, 2) @ inverse @ g)[:, 0, 0]
    w = weights(square)
    cross, Jt = np.swapaxes(A1, 1, 2) @ J, np.swapaxes(J, 1, 2)
    K = np.swapaxes(cross, 1, 2) @ inverse
    used = w > 0.0
    terms, slopes = (Jt @ J - K @ cross)[used], (Jt @ r1 - K @ g)[used, :, 0]
    information = (w[used, None, None] * terms).sum(0)
    gradient = (w[used, None] * slopes).sum(0)
    return information, gradient, used, (inverse @ g)[..., 0], inverse @ cross


def test_the_motion_alone() -> None:
    p, _, now = scene()
    rng = np.random.default_rng(1)
    W = rng.normal(0.0, 300.0, (len(p), 4, 4))
    W = W @ np.swapaxes(W, 1, 2) + 1e5 * np.eye(4)
    bound = 50.0 * BOUND
    found = motion_equations_compiled(T, p, now, W, T_C1_C0, bound, HUBER)
    rotated = p @ T[:3, :3].T
    h, J = project_stereo(rotated + T[:3, 3], T_C1_C0)
    r = now - h
    square = np.einsum("ni,nij,nj->n", r, W, r)
    w = np.where(square < bound, np.minimum(1.0, HUBER / np.sqrt(square)), 0.0)
    used = w > 0.0
    assert 0 < used.sum() < len(p)
    A = np.concatenate([J @ -so3.hat(rotated), J], axis=2)[used]
    AtW = np.swapaxes(A, 1, 2) @ (w[used, None, None] * W[used])
    np.testing.assert_allclose(found[0], (AtW @ A).sum(0), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found[1], (AtW @ r[used, :, None]).sum(0)[:, 0], rtol=1e-9)


def test_the_motion_and_the_points() -> None:
    p, before, now = scene()
    point = np.concatenate([p[:, :2], np.ones((len(p), 1))], axis=1) / p[:, 2:]
    found = motion_and_point_equations_compiled(T, point, before, now, SIGMA, T_C1_C0, BOUND, HUBER)
    expected = with_points(point, before, now)
    np.testing.assert_array_equal(found[2], expected[2])
    assert 0 < found[2].sum() < len(p)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7 * np.nanmax(np.abs(b)))
