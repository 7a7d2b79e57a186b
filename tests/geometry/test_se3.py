"""The laws of SE(3), on every batch shape, near zero and near pi."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

SHAPES = [(), (1,), (4,), (2, 3)]
ANGLES = [0.0, 1e-8, 1e-4, 0.999e-2, 1.001e-2, 0.4, 2.0, np.pi - 1e-3, np.pi - 1e-6]

Derivative = Callable[..., FloatArray]
shapes = pytest.mark.parametrize("shape", SHAPES)
angles = pytest.mark.parametrize("angle", ANGLES)


def twists(angle: float, shape: tuple[int, ...], seed: int = 1) -> FloatArray:
    rng = np.random.default_rng(seed)
    omega, v = rng.normal(size=(2, *shape, 3))
    omega = angle * omega / np.linalg.norm(omega, axis=-1, keepdims=True)
    return np.concatenate([omega, 5.0 * v], axis=-1)


def hat(twist: FloatArray) -> FloatArray:
    out = np.zeros((*twist.shape[:-1], 4, 4))
    out[..., :3, :3] = so3.hat(twist[..., :3])
    out[..., :3, 3] = twist[..., 3:]
    return out


@shapes
@angles
def test_exp_is_the_matrix_exponential(shape: tuple[int, ...], angle: float) -> None:
    xi = twists(angle, shape)
    T = se3.exp(xi)
    assert T.shape == (*shape, 4, 4)
    np.testing.assert_allclose(T, expm(hat(xi)), atol=1e-12)


@shapes
@angles
def test_log_undoes_exp(shape: tuple[int, ...], angle: float) -> None:
    xi = twists(angle, shape)
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, rtol=1e-8, atol=1e-9)


@shapes
@angles
def test_inverse(shape: tuple[int, ...], angle: float) -> None:
    T = se3.exp(twists(angle, shape))
    identity = np.broadcast_to(np.eye(4), T.shape)
    np.testing.assert_allclose(T @ se3.inverse(T), identity, atol=1e-13)
    np.testing.assert_allclose(se3.inverse(T) @ T, identity, atol=1e-13)


@shapes
def test_apply_is_the_product_with_homogeneous_points(shape: tuple[int, ...]) -> None:
    T = se3.exp(twists(1.0, shape))
    p = np.random.default_rng(2).normal(size=(*shape, 3))
    homogeneous = np.concatenate([p, np.ones((*shape, 1))], axis=-1)
    np.testing.assert_allclose(
        se3.apply(T, p), (T @ homogeneous[..., None])[..., :3, 0], atol=1e-13
    )


def test_apply_broadcasts_one_motion_over_points_and_one_point_over_motions() -> None:
    T = se3.exp(twists(1.0, (4,)))
    p = np.random.default_rng(2).normal(size=(4, 3))
    one_motion = se3.apply(T[0], p)
    one_point = se3.apply(T, p[0])
    for i in range(4):
        np.testing.assert_allclose(one_motion[i], se3.apply(T[0], p[i]), atol=1e-15)
        np.testing.assert_allclose(one_point[i], se3.apply(T[i], p[0]), atol=1e-15)


def test_make_broadcasts() -> None:
    T = se3.make(np.eye(3), np.arange(12.0).reshape(4, 3))
    assert T.shape == (4, 4, 4)
    np.testing.assert_array_equal(T[2], [[1, 0, 0, 6], [0, 1, 0, 7], [0, 0, 1, 8], [0, 0, 0, 1]])


@shapes
@angles
def test_adjoint_carries_a_twist_through_a_motion(shape: tuple[int, ...], angle: float) -> None:
    T, xi = se3.exp(twists(angle, shape, 1)), twists(0.6, shape, 2)
    carried = (se3.adjoint(T) @ xi[..., None])[..., 0]
    np.testing.assert_allclose(T @ se3.exp(xi) @ se3.inverse(T), se3.exp(carried), atol=1e-11)


@angles
def test_right_jacobian_by_differences(angle: float, central_differences: Derivative) -> None:
    xi = twists(angle, ())

    def moved(at: FloatArray) -> FloatArray:
        return se3.log(se3.inverse(se3.exp(xi)) @ se3.exp(at))

    np.testing.assert_allclose(se3.right_jacobian(xi), central_differences(moved, xi), atol=5e-9)


@shapes
def test_right_jacobian_of_a_batch_is_that_of_each(shape: tuple[int, ...]) -> None:
    xi = twists(1.5, shape)
    flat = [se3.right_jacobian(x) for x in xi.reshape(-1, 6)]
    expected = np.stack(flat).reshape(*shape, 6, 6)
    np.testing.assert_allclose(se3.right_jacobian(xi), expected, atol=1e-14)
