"""The compiled questions about bodies against plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.bodies_kernel import (
    Grouped,
    RoadUser,
    can_be_bodies,
    can_be_bodies_compiled,
    distance_from_rest,
    distance_from_rest_compiled,
    height_above_ground,
    known_part,
    velocity_distance,
    without_parts,
    without_parts_compiled,
)
from ovmot.objects.clustering_kernel import OneBody
from ovmot.objects.measurement_kernel import MeasuredBodies
from ovmot.physics import gate

ONE = OneBody(radius_m=1.8, velocity_gate=gate(3, 0.95), turn_mps=0.5, width_m=2.6, sigmas=2.0)
USER = RoadUser(3, 0.5, 1.5, 4.0, 0.1, 0.3, 4.5)


def covariances(rng: np.random.Generator, n: int, size: int = 3) -> FloatArray:
    """Covariances (n, size, size)."""
    A = rng.normal(size=(n, size, size))
    return np.asarray(A @ A.swapaxes(-1, -2) + 0.1 * np.eye(size))


def measured_bodies(
    p_world: list[FloatArray], velocity: FloatArray, covariance: FloatArray
) -> tuple[MeasuredBodies, FloatArray]:
    """Bodies of given points, velocities (B, 3) and covariances (B, 6, 6), and all their points."""
    n, n_members = len(p_world), np.array([len(p) for p in p_world])
    none, middle = np.zeros((n, 3)), np.stack([np.median(p, axis=0) for p in p_world])
    return MeasuredBodies(
        np.arange(n_members.sum()), np.cumsum(n_members) - n_members, n_members, none, middle, none,
        velocity, np.zeros((n, 4, 4)), covariance,
    ), np.concatenate(p_world)  # fmt: skip


def test_distance_of_velocities() -> None:
    rng = np.random.default_rng(1)
    v, C = rng.normal(size=3), covariances(rng, 1)[0]
    expected = v @ np.linalg.solve(C + 0.3**2 * np.eye(3), v)
    assert velocity_distance(v, C, 0.3) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("n", [3, 25])
def test_height_above_the_ground(n: int) -> None:
    rng = np.random.default_rng(2)
    p, static = rng.normal(size=(n + 4, 3)), 5.0 * rng.normal(size=(60, 3))
    own = rng.permutation(n + 4)[:n]
    off = static[:, :2] - p[own, :2].mean(axis=0)
    near = np.flatnonzero((off**2).sum(axis=1) < 4.0**2)
    heights = np.sort(static[near, 2])
    expected = np.sort(p[own, 2])[-1 - n // 10] - heights[len(near) // 10]
    user = USER._replace(ground_radius_m=4.0)
    found = height_above_ground(p, own, static, user)
    assert found == pytest.approx(expected, rel=1e-14)
    assert height_above_ground(p, own, static[near[:2]], user) == np.inf


def test_the_known_part_is_along_the_least_axes() -> None:
    rng = np.random.default_rng(1)
    A, v, C = rng.normal(0.0, 2.0, (3, 3)), rng.normal(size=3), np.eye(6)
    C[3:, 3:] = A @ A.T
    variance, axes = np.linalg.eigh(A @ A.T)
    for sigma, n in ((100.0, 3), (float(np.sqrt(variance[1:]).mean()), 2), (1e-9, 0)):
        component, found = known_part(v, C, sigma)
        np.testing.assert_allclose(found, variance[:n], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(np.abs(component), np.abs(axes.T[:n] @ v), rtol=1e-8)


@pytest.mark.parametrize("kernel", [distance_from_rest, distance_from_rest_compiled])
def test_distance_from_rest(kernel: Callable[..., tuple[FloatArray, IntArray]]) -> None:
    rng = np.random.default_rng(6)
    v, C = rng.normal(size=(9, 3)), 0.3 * covariances(rng, 9, 6)
    distance, dof = kernel(v, C, 1.5)
    assert set(dof.tolist()) >= {1, 2, 3}
    for b in range(9):
        variance, axes = np.linalg.eigh(C[b, 3:, 3:])
        known = variance < 1.5**2
        assert dof[b] == known.sum()
        expected = ((v[b] @ axes) ** 2 / variance)[known].sum()
        assert distance[b] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("kernel", [can_be_bodies, can_be_bodies_compiled])
def test_what_can_be_a_body(kernel: Callable[..., BoolArray]) -> None:
    """A car can; not two points, a road's patch, windows high up, what is slow or only drifts."""
    rng = np.random.default_rng(3)
    road = np.column_stack([rng.uniform(-3.0, 3.0, (40, 2)), rng.normal(-1.7, 0.02, 40)])
    wall = np.column_stack([rng.uniform(-3.0, 3.0, (40, 2)), rng.uniform(-1.5, 2.0, 40)])
    patch = np.column_stack([rng.uniform(-1.0, 1.0, (6, 2)), rng.normal(-1.68, 0.03, 6)])
    ahead, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    car = patch + up * rng.uniform(0.3, 1.3, (6, 1))
    elsewhere, windows = patch + 20.0 * ahead, car + 20.0 * ahead + 8.0 * up
    slope = windows + 30.0 * ahead
    fast, slow, drift = 4.0 * ahead, 0.4 * ahead, np.array([0.4, 9.0, 0.0])
    cases = [
        (car, fast, True), (car[:2], fast, False), (patch, fast, False), (elsewhere, fast, True),
        (windows, fast, False), (slope, fast, True), (car, slow, False), (car, drift, False),
    ]  # fmt: skip
    C = np.tile(np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]), (len(cases), 1, 1))
    C[-1, 4, 4] = 3.0  # little is known along what drifts
    measured, p_world = measured_bodies(
        [p for p, _, _ in cases], np.stack([v for _, v, _ in cases]), C
    )
    T = se3.exp(np.array([0.1, -0.2, 0.3, 0.5, -0.3, 0.1]))
    scene = np.concatenate([road, wall, car - 4.0 * up, np.full((1, 3), np.nan)])
    is_static = np.ones(len(scene), np.bool_)
    is_static[80:-1] = False  # the lowest ones move
    p_cam0 = se3.apply(se3.inverse(T), scene)
    found = kernel(measured, p_world, p_cam0, is_static, T, USER)
    assert found.tolist() == [expected for _, _, expected in cases]
    few = np.zeros(len(scene), np.bool_)
    few[:2] = True  # too few to know the ground
    assert kernel(measured, p_world, p_cam0, few, T, USER)[2]


@pytest.mark.parametrize("kernel", [without_parts, without_parts_compiled])
def test_parts_of_larger_bodies_are_left_out(kernel: Callable[..., IntArray]) -> None:
    """By velocity, place, track, and group or number of points."""
    rng = np.random.default_rng(7)

    def points(n: int, ahead: float) -> FloatArray:
        return rng.uniform(-0.3, 0.3, (n, 3)) + ahead * np.array([1.0, 0.0, 0.0])

    reach = ONE.radius_m + ONE.sigmas * np.sqrt(2.0) * 0.3
    near, far, v = 0.9 * reach, -1.1 * reach - 0.6, np.array([5.0, 0.0, 0.0])
    # points, velocity, track, group, kept
    bodies = [
        (points(6, near), v, -1, 0, False), (points(12, 0.0), v, 3, 0, True),
        (points(6, far), v, -1, 0, True), (points(6, near), v, 4, 0, True),
        (points(6, near), v, 3, 1, True), (points(4, near), v, 3, 1, False),
        (points(6, near), v + v[[1, 0, 2]], 3, 0, True), (points(20, 0.0), v, 3, 0, False),
    ]  # fmt: skip
    C = np.tile(np.diag([0.09, 0.04, 0.04, 0.1, 0.1, 0.1]), (len(bodies), 1, 1))
    measured, p_world = measured_bodies([b[0] for b in bodies], np.stack([b[1] for b in bodies]), C)
    shuffled = rng.permutation(len(p_world) + 5)
    track_id = np.full(len(shuffled), 9)
    track_id[shuffled[: len(p_world)]] = np.repeat([b[2] for b in bodies], measured.n_members)
    grouped = Grouped(shuffled[: len(p_world)], track_id, np.array([b[3] for b in bodies]))
    moves = np.ones(len(bodies), np.bool_)
    moves[7] = False
    kept = kernel(measured, p_world, moves, grouped, ONE)
    assert sorted(kept.tolist()) == [k for k, b in enumerate(bodies) if b[4]]
    assert kept[0] == 1 and (np.diff(measured.n_members[kept]) <= 0).all()
    assert kernel(measured, p_world, ~moves, grouped, ONE).tolist() == [7]
