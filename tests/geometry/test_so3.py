"""The laws of SO(3), on every batch shape, near zero and near pi."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray

SHAPES = [(), (1,), (4,), (2, 3)]
ANGLES = [0.0, 1e-9, 1e-6, 0.999e-3, 1.001e-3, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-5, np.pi - 1e-8]

Derivative = Callable[..., FloatArray]
shapes = pytest.mark.parametrize("shape", SHAPES)
angles = pytest.mark.parametrize("angle", ANGLES)


def vectors_of_norm(angle: float, shape: tuple[int, ...], seed: int = 1) -> FloatArray:
    directions = np.random.default_rng(seed).normal(size=(*shape, 3))
    out: FloatArray = angle * directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return out


@shapes
def test_hat_is_the_cross_product(shape: tuple[int, ...]) -> None:
    v, w = vectors_of_norm(2.0, shape, 1), vectors_of_norm(3.0, shape, 2)
    np.testing.assert_allclose((so3.hat(v) @ w[..., None])[..., 0], np.cross(v, w), atol=1e-14)


@shapes
@angles
def test_exp_is_the_matrix_exponential(shape: tuple[int, ...], angle: float) -> None:
    v = vectors_of_norm(angle, shape)
    R = so3.exp(v)
    assert R.shape == (*shape, 3, 3)
    np.testing.assert_allclose(R, expm(so3.hat(v)), atol=2e-14)


@shapes
@angles
def test_log_undoes_exp(shape: tuple[int, ...], angle: float) -> None:
    v = vectors_of_norm(angle, shape)
    np.testing.assert_allclose(so3.log(so3.exp(v)), v, rtol=1e-7, atol=1e-11)


@angles
def test_log_keeps_small_parts_of_a_batch_apart_from_large_ones(angle: float) -> None:
    v = np.stack([vectors_of_norm(a, ()) for a in (angle, 0.0, np.pi - 1e-7, 1.0)])
    np.testing.assert_allclose(so3.log(so3.exp(v)), v, rtol=1e-7, atol=1e-11)


def test_log_at_exactly_pi_gives_one_of_the_two_axes() -> None:
    v = np.pi * np.eye(3)
    found = so3.log(so3.exp(v))
    np.testing.assert_allclose(np.abs(found), v, atol=1e-12)


def test_log_of_nan_is_nan_and_leaves_its_neighbours_alone() -> None:
    v = np.array([[0.1, 0.2, 0.3], [0.0, 0.0, np.pi - 1e-6]])
    R = np.concatenate([so3.exp(v), np.full((1, 3, 3), np.nan)])
    found = so3.log(R)
    np.testing.assert_allclose(found[:2], v, rtol=1e-9)
    assert np.all(np.isnan(found[2]))


@shapes
@angles
def test_inverse_is_the_transpose(shape: tuple[int, ...], angle: float) -> None:
    v = vectors_of_norm(angle, shape)
    identity = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    np.testing.assert_allclose(so3.exp(v) @ so3.exp(-v), identity, atol=1e-14)
    np.testing.assert_allclose(so3.exp(-v), np.swapaxes(so3.exp(v), -1, -2), atol=1e-14)


@shapes
@angles
def test_a_rotation_is_its_own_adjoint(shape: tuple[int, ...], angle: float) -> None:
    R, w = so3.exp(vectors_of_norm(angle, shape, 1)), vectors_of_norm(0.7, shape, 2)
    turned = (R @ w[..., None])[..., 0]
    np.testing.assert_allclose(R @ so3.exp(w) @ np.swapaxes(R, -1, -2), so3.exp(turned), atol=1e-13)


@angles
def test_right_jacobian_by_differences(angle: float, central_differences: Derivative) -> None:
    v = vectors_of_norm(angle, ())

    def moved(at: FloatArray) -> FloatArray:
        return so3.log(so3.exp(v).T @ so3.exp(at))

    np.testing.assert_allclose(so3.right_jacobian(v), central_differences(moved, v), atol=2e-9)


@angles
def test_left_jacobian_by_differences(angle: float, central_differences: Derivative) -> None:
    v = vectors_of_norm(angle, ())

    def moved(at: FloatArray) -> FloatArray:
        return so3.log(so3.exp(at) @ so3.exp(v).T)

    np.testing.assert_allclose(so3.left_jacobian(v), central_differences(moved, v), atol=2e-9)


@shapes
@angles
def test_right_jacobian_inverse_undoes_it(shape: tuple[int, ...], angle: float) -> None:
    v = vectors_of_norm(angle, shape)
    product = so3.right_jacobian_inverse(v) @ so3.right_jacobian(v)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-10)


@shapes
@angles
def test_quaternions_go_round(shape: tuple[int, ...], angle: float) -> None:
    R = so3.exp(vectors_of_norm(angle, shape))
    q = so3.to_quaternion(R)
    assert q.shape == (*shape, 4)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-14)
    assert np.all(q[..., 3] >= 0.0)
    np.testing.assert_allclose(so3.from_quaternion(q), R, atol=1e-13)
    np.testing.assert_allclose(so3.from_quaternion(-q), R, atol=1e-13)


def test_quaternion_order_is_x_y_z_w() -> None:
    quarter_turn_left = so3.exp(np.array([0.0, 0.0, 0.5 * np.pi]))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(so3.to_quaternion(quarter_turn_left), [0, 0, half, half], atol=1e-14)
    np.testing.assert_allclose(quarter_turn_left @ [1.0, 0.0, 0.0], [0, 1, 0], atol=1e-14)


@shapes
def test_projection_leaves_rotations_and_cleans_their_noise(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    R = so3.exp(vectors_of_norm(1.2, shape))
    np.testing.assert_allclose(so3.project_to_rotation(R), R, atol=1e-14)
    noisy = R + 1e-3 * rng.normal(size=R.shape)
    clean = so3.project_to_rotation(noisy)
    np.testing.assert_allclose(
        clean @ np.swapaxes(clean, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14
    )
    # nearest: no rotation in its neighbourhood is nearer
    distance = np.linalg.norm(clean - noisy, axis=(-2, -1))
    for w in 1e-3 * rng.normal(size=(20, 3)):
        other = np.linalg.norm(clean @ so3.exp(w) - noisy, axis=(-2, -1))
        assert np.all(other > distance)


def test_projection_of_a_reflection_is_a_rotation() -> None:
    R = so3.project_to_rotation(np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "opening", [0.0, 1e-13, 1e-9, 1e-6, 0.5, 2.0, *(np.pi - np.logspace(-13, -3, 6)), np.pi]
)
def test_between_vectors_turns_one_onto_the_other_by_the_least_angle(opening: float) -> None:
    for a, axis in zip(vectors_of_norm(1.0, (5,), 4), vectors_of_norm(1.0, (5,), 5), strict=True):
        normal = np.cross(a, axis) / np.linalg.norm(np.cross(a, axis))
        b = so3.exp(opening * normal) @ a
        R = so3.between_vectors(3.0 * a, 0.2 * b)
        np.testing.assert_allclose(R @ a, b, atol=1e-12)
        assert np.linalg.norm(so3.log(R)) == pytest.approx(opening, abs=1e-12)


def test_rotation_about_z_is_the_exponential_along_z() -> None:
    yaw = np.random.default_rng(4).uniform(-4.0, 4.0, (2, 3))
    expected = so3.exp(yaw[..., None] * np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(so3.rotation_z(yaw), expected, atol=1e-12)
    np.testing.assert_allclose(so3.rotation_z(0.5 * np.pi) @ [1.0, 0.0, 2.0], [0, 1, 2], atol=1e-12)
