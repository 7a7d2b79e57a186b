"""Neighbours that move alike: near, and of one velocity."""

from collections.abc import Sequence

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.segmentation.neighbour_consensus import neighbours_with_same_velocity


def pairs(
    p: Sequence[Sequence[float]], v: Sequence[Sequence[float]], sigma_z: float = 0.3
) -> BoolArray:
    n = len(p)
    cov_p = np.broadcast_to(np.diag([0.01, 0.01, sigma_z**2]), (n, 3, 3))
    cov_v = np.broadcast_to(0.1**2 * np.eye(3), (n, 3, 3))
    everyone = np.ones(n, dtype=np.bool_)
    return neighbours_with_same_velocity(np.array(p), cov_p, np.array(v), cov_v, everyone)


def test_two_near_points_of_one_velocity_support_each_other() -> None:
    alike = pairs([[0, 0, 10], [1, 0, 10.5]], [[3, 0, 0], [3.2, 0, 0.1]])
    np.testing.assert_array_equal(alike, ~np.eye(2, dtype=np.bool_))


def test_different_velocities_do_not() -> None:
    assert not pairs([[0, 0, 10], [1, 0, 10.5]], [[3, 0, 0], [-3, 0, 0]]).any()


def test_points_apart_do_not() -> None:
    assert not pairs([[0, 0, 10], [4, 0, 10]], [[3, 0, 0], [3, 0, 0]]).any()
    assert not pairs([[0, 0, 10], [0, 0, 16]], [[3, 0, 0], [3, 0, 0]]).any()


def test_depth_reaches_as_far_as_it_is_uncertain() -> None:
    apart = [[0.0, 0.0, 30.0], [0.0, 0.0, 36.0]]
    assert not pairs(apart, [[3, 0, 0], [3, 0, 0]], sigma_z=0.3).any()
    assert pairs(apart, [[3, 0, 0], [3, 0, 0]], sigma_z=2.5).any()


def test_only_candidates_count() -> None:
    p: FloatArray = np.array([[0.0, 0, 10], [0.5, 0, 10], [1, 0, 10]])
    v, C = np.full((3, 3), 2.0), np.broadcast_to(0.01 * np.eye(3), (3, 3, 3))
    candidates = np.array([True, False, True])
    alike = neighbours_with_same_velocity(p, C, v, C, candidates)
    assert alike[0, 2]
    assert alike[2, 0]
    assert alike.sum() == 2
    one = np.array([True, False, False])
    assert not neighbours_with_same_velocity(p, C, v, C, one).any()
