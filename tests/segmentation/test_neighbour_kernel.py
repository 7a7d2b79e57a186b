"""Neighbours that move alike: near, and of one velocity."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.physics import CAR_SIZE_M, TURN_SPREAD_MPS, gate
from ovmot.segmentation.neighbour_kernel import count_alike, count_alike_compiled

RADIUS_M, GATE = 0.5 * CAR_SIZE_M[0], gate(3, 0.99)


def counts(
    p: Sequence[Sequence[float]], v: Sequence[Sequence[float]], sigma_z: float = 0.3
) -> list[int]:
    n = len(p)
    cov_p = np.broadcast_to(np.diag([0.01, 0.01, sigma_z**2]), (n, 3, 3)).copy()
    cov_v = np.broadcast_to(0.1**2 * np.eye(3), (n, 3, 3)).copy()
    found = count_alike_compiled(
        np.array(p, np.float64), cov_p, np.array(v, np.float64), cov_v, np.arange(n),
        np.ones((n, 1), np.bool_), RADIUS_M, TURN_SPREAD_MPS, GATE,
    )  # fmt: skip
    return [int(k) for k in found[:, 0]]


def twin(
    p: FloatArray, cov_p: FloatArray, v: FloatArray, cov_v: FloatArray, index: IntArray
) -> FloatArray:
    """Which pairs (N, N) of the candidates are near and move alike, by a k-d tree."""
    alike = np.zeros((len(p), len(p)))
    reach_z = RADIUS_M + 2.0 * np.sqrt(cov_p[index, 2, 2])
    scaled = np.column_stack([p[index, :2] / RADIUS_M, p[index, 2] / reach_z])
    found = cKDTree(scaled).query(scaled, k=11, distance_upper_bound=1.0)
    distance, other = np.asarray(found[0]), np.asarray(found[1])
    for a, slot in zip(*np.nonzero(np.isfinite(distance[:, 1:])), strict=True):
        i, j = index[a], index[other[a, slot + 1]]
        C = cov_v[i] + cov_v[j] + TURN_SPREAD_MPS**2 * np.eye(3)
        alike[i, j] = (v[i] - v[j]) @ np.linalg.solve(C, v[i] - v[j]) < GATE
    return alike


@pytest.mark.parametrize("count", [count_alike, count_alike_compiled])
def test_the_counts_are_those_of_the_twin(count: Callable[..., IntArray]) -> None:
    rng = np.random.default_rng(2)
    p = rng.uniform([-6.0, -1.0, 8.0], [6.0, 1.0, 20.0], (150, 3))
    v = rng.normal(0.0, 1.0, (150, 3))
    A = rng.normal(0.0, 0.3, (2, 150, 3, 3))
    cov_p, cov_v = A @ np.swapaxes(A, -1, -2)
    index = np.flatnonzero(rng.random(150) < 0.8)
    kind = rng.random((150, 3)) < 0.5
    found = count(p, cov_p, v, cov_v, index, kind, RADIUS_M, TURN_SPREAD_MPS, GATE)
    alike = twin(p, cov_p, v, cov_v, index)
    assert 100 < alike.sum() < 1500
    np.testing.assert_array_equal(found, alike @ kind)


def test_two_near_points_of_one_velocity_support_each_other() -> None:
    assert counts([[0, 0, 10], [1, 0, 10.5]], [[3, 0, 0], [3.2, 0, 0.1]]) == [1, 1]


def test_different_velocities_do_not() -> None:
    assert counts([[0, 0, 10], [1, 0, 10.5]], [[3, 0, 0], [-3, 0, 0]]) == [0, 0]


def test_points_apart_do_not() -> None:
    assert counts([[0, 0, 10], [4, 0, 10]], [[3, 0, 0], [3, 0, 0]]) == [0, 0]
    assert counts([[0, 0, 10], [0, 0, 16]], [[3, 0, 0], [3, 0, 0]]) == [0, 0]


def test_depth_reaches_as_far_as_it_is_uncertain() -> None:
    apart = [[0.0, 0.0, 30.0], [0.0, 0.0, 36.0]]
    assert counts(apart, [[3, 0, 0], [3, 0, 0]], sigma_z=0.3) == [0, 0]
    assert counts(apart, [[3, 0, 0], [3, 0, 0]], sigma_z=2.5) == [1, 1]


def test_only_candidates_count() -> None:
    p: FloatArray = np.array([[0.0, 0, 10], [0.5, 0, 10], [1, 0, 10]])
    v, C = np.full((3, 3), 2.0), np.broadcast_to(0.01 * np.eye(3), (3, 3, 3)).copy()
    everyone = np.ones((3, 1), np.bool_)
    for candidates, expected in (([0, 2], [1, 0, 1]), ([0], [0, 0, 0]), ([], [0, 0, 0])):
        index = np.array(candidates, np.int64)
        found = count_alike_compiled(p, C, v, C, index, everyone, RADIUS_M, TURN_SPREAD_MPS, GATE)
        assert found[:, 0].tolist() == expected
