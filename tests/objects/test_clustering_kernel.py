"""The compiled clustering equals its plain twin, by SciPy's k-d tree and graph search."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.clustering_kernel import (
    OneBody,
    PointMotions,
    cluster,
    cluster_compiled,
)
from ovmot.physics import gate

NEIGHBOURS = 5
ONE = OneBody(radius_m=1.8, velocity_gate=gate(3, 0.99), turn_mps=0.5, width_m=2.6, sigmas=2.0)


def street(seed: int) -> PointMotions:
    """Bodies side by side and behind each other, some with tracks, of two velocities."""
    rng = np.random.default_rng(seed)
    n_bodies, parts = 9, []
    centre = rng.uniform([-8.0, -0.5, 8.0], [8.0, 0.5, 30.0], (n_bodies, 3))
    centre[1] = centre[0] + [2.3, 0.0, 0.5]
    for k in range(n_bodies):
        n = int(rng.integers(2, 22))
        p = centre[k] + rng.uniform([-0.9, -0.7, -1.5], [0.9, 0.7, 1.5], (n, 3))
        v = np.array([0.0, 0.0, 6.0 if k % 3 else -4.0]) + rng.normal(0.0, 0.3, (n, 3))
        track = np.full(n, k if k % 2 else -1)
        parts.append((p, v, track))
    p, v, track_id = (np.concatenate(column) for column in zip(*parts, strict=True))
    A, B = rng.normal(0.0, 0.05, (len(p), 3, 3)), rng.normal(0.0, 0.3, (len(p), 3, 3))
    cov = A @ np.swapaxes(A, -1, -2)
    cov[:, 2, 2] += (0.0015 * p[:, 2] ** 2) ** 2
    shuffled = rng.permutation(len(p))
    velocity_cov = B @ np.swapaxes(B, -1, -2) + 0.01 * np.eye(3)
    return PointMotions(
        p[shuffled], cov[shuffled], v[shuffled], velocity_cov[shuffled], track_id[shuffled],
        np.array([0.02, -0.999, 0.03]),
    )  # fmt: skip


@pytest.mark.parametrize("search", [cluster, cluster_compiled])
def test_clusters_are_those_of_the_twin(
    search: Callable[..., tuple[IntArray, IntArray]],
) -> None:
    sizes = []
    for seed in range(8):
        points = street(seed)
        order, size = search(points, ONE, 3)
        expected = twin(points, 3)
        found = np.split(order, np.cumsum(size)[:-1])
        assert [g.tolist() for g in found] == [g.tolist() for g in expected]
        sizes += size.tolist()
    assert len(sizes) > 30 and max(sizes) > 20


def twin(points: PointMotions, min_points: int) -> list[IntArray]:
    """The clusters, by k-d tree, graph search and NumPy."""
    scaled = depth_scaled(points.p, points.cov, ONE.radius_m)
    pairs = neighbour_pairs(scaled, ONE.radius_m)
    pairs = pairs[same_velocity(points, pairs) & compatible_pairs(points.track_id[pairs])]
    n = len(scaled)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    component = connected_components(graph, directed=False)[1]
    distance = cdist(scaled, scaled)
    several = np.flatnonzero(np.bincount(component) > 1)
    linked = [np.flatnonzero(component == k) for k in several]
    narrow = [part for whole in linked for part in split_at_gap(points, whole)]
    groups: list[IntArray] = []
    for part in sorted(narrow, key=len, reverse=True):
        for k, group in enumerate(groups):
            if are_one_body(points, distance, group, part):
                groups[k] = np.concatenate([group, part])
                break
        else:
            groups.append(part)
    return [group for group in groups if len(group) >= min_points]


def split_at_gap(points: PointMotions, index: IntArray) -> list[IntArray]:
    """A component (n,), or the parts of one that is wider than a body, split at its widest gap.

    Vehicles that start side by side move alike and are linked over the gap between them.
    """
    lateral, sigma = lateral_positions(points, index)
    order = np.argsort(lateral)
    gaps = np.diff(lateral[order])
    if np.ptp(lateral) - 4.0 * sigma <= ONE.width_m:
        return [index]
    cut = int(np.argmax(gaps)) + 1
    sides = index[order[:cut]], index[order[cut:]]
    return [part for side in sides for part in split_at_gap(points, side)]


def lateral_positions(points: PointMotions, index: IntArray) -> tuple[FloatArray, float]:
    """Horizontal positions (n,) of points across their median velocity, and their standard
    deviation, metres."""
    across = so3.hat(points.up) @ median(points.velocity[index])
    across = across / max(float(np.linalg.norm(across)), 1e-9)
    variance = median((points.cov[index] @ across) @ across)
    return points.p[index] @ across, float(np.sqrt(variance))


def median(rows: FloatArray) -> FloatArray:
    """The median of rows (n, ...): of few rows, NumPy's takes several times as long."""
    ordered, n = np.sort(rows, axis=0), len(rows)
    median: FloatArray = 0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])
    return median


def are_one_body(
    points: PointMotions,
    distance: FloatArray,
    group: IntArray,
    part: IntArray,
) -> bool:
    """Do two groups touch, have one velocity, and together measure no more across than a body?"""
    track_id, other = majority_track(points.track_id[group]), majority_track(points.track_id[part])
    if track_id != other and min(track_id, other) >= 0:
        return False
    same_track = track_id == other >= 0  # the far end of a lorry
    if not same_track and distance[group[:, None], part].min() > ONE.radius_m:
        return False
    v_group, v_part = (median(points.velocity[index]) for index in (group, part))
    C = sum(points.velocity_cov[index].mean(0) / len(index) for index in (group, part))
    error = v_part - v_group
    if error @ np.linalg.solve(C + ONE.turn_mps**2 * np.eye(3), error) >= ONE.velocity_gate:
        return False
    lateral, sigma = lateral_positions(points, np.concatenate([group, part]))
    return bool(np.ptp(lateral) - 4.0 * sigma <= ONE.width_m)


def majority_track(track_id: IntArray) -> int:
    """The track that holds most of the points (n,); -1 where no track holds one."""
    held = track_id[track_id >= 0]
    return int(np.bincount(held).argmax()) if len(held) else -1


def compatible_pairs(track_ids: IntArray) -> BoolArray:
    """Which pairs of track ids (P, 2) are not two different tracks; -1 is no track."""
    compatible: BoolArray = (track_ids[:, 0] == track_ids[:, 1]) | (track_ids < 0).any(axis=1)
    return compatible


def depth_scaled(p_cam0: FloatArray, cov_cam0: FloatArray, radius: float) -> FloatArray:
    """Points (M, 3) with their depth scaled so that the search radius is the same along the ray.

    The standard deviation of stereo depth is s z², so that the reach along the ray is r + k s z².
    In the depth u(z) = ∫ r dz / (r + k s z²) = sqrt(r / k s) atan(z sqrt(k s / r)) it is r
    everywhere.
    """
    z = p_cam0[:, 2]
    # The difference of two points has √2 times the deviation of one.
    ks = ONE.sigmas * np.sqrt(2.0) * float(np.median(np.sqrt(cov_cam0[:, 2, 2]) / z**2))
    u = np.sqrt(radius / ks) * np.arctan(z * np.sqrt(ks / radius))
    return np.column_stack([p_cam0[:, :2], u])


def neighbour_pairs(scaled: FloatArray, radius: float) -> IntArray:
    """Pairs (P, 2) of mutual nearest neighbours within `radius`.

    Mutual ones only, so that bodies side by side with many points stay apart.
    """
    n = len(scaled)
    k = min(NEIGHBOURS + 1, n)
    found = cKDTree(scaled).query(scaled, k=k, distance_upper_bound=radius)
    distance, other = np.asarray(found[0]), np.asarray(found[1])
    a, slot = np.nonzero(np.isfinite(distance[:, 1:]))
    link = np.sort(a * n + other[:, 1:][a, slot])  # from k to m: k n + m
    start, end = np.divmod(link, n)
    mutual = (start < end) & contained(end * n + start, link)
    return np.column_stack([start[mutual], end[mutual]])


def same_velocity(points: PointMotions, pairs: IntArray) -> BoolArray:
    """Which pairs (P,) have velocities that agree within their covariance."""
    a, b = pairs[:, 0], pairs[:, 1]
    dv = points.velocity[a] - points.velocity[b]
    C = points.velocity_cov[a] + points.velocity_cov[b] + ONE.turn_mps**2 * np.eye(3)
    agrees: BoolArray = squared_distance(dv, C) < ONE.velocity_gate
    return agrees
