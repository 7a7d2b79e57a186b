"""Closed-form registration recovers motions, in batches, and flat triangles are told."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.registration import register_rigid, triangle_height


def test_recovers_a_batch_of_motions() -> None:
    rng = np.random.default_rng(1)
    T = se3.exp(rng.normal(0.0, 1.0, (7, 6)))
    p = rng.normal(0.0, 2.0, (7, 5, 3))
    found = register_rigid(p, se3.apply(T[:, None], p))
    np.testing.assert_allclose(found, T, atol=1e-12)


def test_three_points_are_enough_and_no_mirror_image_comes_out() -> None:
    rng = np.random.default_rng(2)
    T = se3.exp(rng.normal(0.0, 1.0, 6))
    p = rng.normal(0.0, 1.0, (3, 3))
    found = register_rigid(p, se3.apply(T, p))
    np.testing.assert_allclose(found, T, atol=1e-9)
    mirrored = register_rigid(rng.normal(0.0, 1.0, (40, 4, 3)), rng.normal(0.0, 1.0, (40, 4, 3)))
    np.testing.assert_allclose(np.linalg.det(mirrored[:, :3, :3]), 1.0, atol=1e-9)


def test_least_squares_against_small_turns_either_way() -> None:
    rng = np.random.default_rng(3)
    p = rng.normal(0.0, 1.0, (30, 3))
    q = se3.apply(se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])), p)
    q = q + rng.normal(0.0, 0.05, q.shape)
    T = register_rigid(p, q)
    cost = np.sum((q - se3.apply(T, p)) ** 2)
    for turn in 0.01 * np.concatenate([np.eye(3), -np.eye(3)]):
        R = T[:3, :3] @ so3.exp(turn)
        t = q.mean(0) - R @ p.mean(0)
        assert np.sum((q - se3.apply(se3.make(R, t), p)) ** 2) > cost


def test_height_of_triangles() -> None:
    right = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    line = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [5.0, 5.0, 5.0]])
    same = np.ones((3, 3))
    height = triangle_height(np.stack([right, line, same]))
    assert height == pytest.approx([2.4, 0.0, 0.0], abs=1e-12)
