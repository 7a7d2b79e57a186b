"""The compiled clustering of moving points: linked neighbours, split at gaps, merged to bodies.

tests/objects/test_clustering_kernel.py holds the plain twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import squared_mahalanobis
from ovmot.kernels.sorting import median, sort_together
from ovmot.segmentation.neighbour_kernel import nearest

_NEIGHBOURS = 5
"""Two linked points are among each other's so many nearest ones: ln M for a hundred points. So many
keep the graph of one cluster in one piece (M. Brito et al., Statistics & Probability Letters 35,
1997)."""


class OneBody(NamedTuple):
    """What the points of one body have in common.

    Each has a neighbour within `radius_m`; velocities agree within `velocity_gate`, a squared
    Mahalanobis distance, and `turn_mps`, by which points of a turning body differ; they are within
    `width_m` across their way. A place may be off by so many standard deviations, `sigmas`.
    """

    radius_m: float
    velocity_gate: float
    turn_mps: float
    width_m: float
    sigmas: float


class PointMotions(NamedTuple):
    """M points in the left camera: positions, velocities and their covariances, SI.

    `p`, `velocity` (M, 3); `cov`, `velocity_cov` (M, 3, 3); `track_id` (M,), -1 for none; `up`
    (3,): the world's z.
    """

    p: FloatArray
    cov: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray
    track_id: IntArray
    up: FloatArray


def cluster(points: PointMotions, one: OneBody, min_points: int) -> tuple[IntArray, IntArray]:
    """Indices of the points (K,) of all clusters, one after the other, and the sizes (G,).

    Connected components of neighbours with one velocity, split at gaps across it where they are
    wider than a body. Components that have one velocity, touch or are of one track, and together
    are no wider than a body are merged, the largest first.
    """
    n = len(points.p)
    scaled, values, lateral = np.empty((n, 3)), np.empty(n), np.empty(n)
    order, start = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    scale_depths(points, one, scaled, values)
    root = linked(points, scaled, one)
    n_parts = several(root, order, start)
    n_parts = split_at_gaps(points, one, order, start, n_parts, values, lateral)
    by_size, key = np.empty(n_parts, np.int64), np.empty(n_parts)
    for k in range(n_parts):  # stable: of one size the first comes first
        by_size[k], key[k] = k, k - float(n + 1) * (start[k + 1] - start[k])
    sort_together(key, by_size, n_parts)
    members, size, n_groups = np.empty((n_parts, n), np.int64), np.zeros(n_parts, np.int64), 0
    both = np.empty(n, np.int64)
    for k in range(n_parts):
        part_of_it = order[start[by_size[k]] : start[by_size[k] + 1]]
        chosen = n_groups
        for g in range(n_groups):
            group = members[g, : size[g]]
            if may_touch(points, scaled, group, part_of_it) and are_one_body(
                points, one, group, part_of_it, values, lateral, both
            ):
                chosen = g
                break
        n_groups = max(n_groups, chosen + 1)
        for m in part_of_it:
            members[chosen, size[chosen]] = m
            size[chosen] += 1
    count, kept = 0, 0
    sizes = np.empty(n_groups, np.int64)
    for g in range(n_groups):
        if size[g] >= min_points:
            for k in range(size[g]):
                order[count] = members[g, k]
                count += 1
            sizes[kept] = size[g]
            kept += 1
    return order[:count], sizes[:kept]


@part
def scale_depths(
    points: PointMotions, one: OneBody, scaled: FloatArray, values: FloatArray
) -> None:
    """Points (M, 3) in units of the radius, the depth scaled so that it is one along the ray too.

    The standard deviation of stereo depth is s z², so that the reach along the ray is r + k s z².
    In the depth u(z) = ∫ r dz / (r + k s z²) = sqrt(r / k s) atan(z sqrt(k s / r)) it is r
    everywhere.
    """
    n, radius = len(points.p), one.radius_m
    for k in range(n):
        values[k] = math.sqrt(points.cov[k, 2, 2]) / points.p[k, 2] ** 2
    # the difference of two points has √2 times the deviation of one
    ks = one.sigmas * math.sqrt(2.0) * median(values, n)
    for k in range(n):
        scaled[k, 0], scaled[k, 1] = points.p[k, 0] / radius, points.p[k, 1] / radius
        u = math.sqrt(radius / ks) * math.atan(points.p[k, 2] * math.sqrt(ks / radius))
        scaled[k, 2] = u / radius


@part
def linked(points: PointMotions, scaled: FloatArray, one: OneBody) -> IntArray:
    """The first point (M,) of each one's component, by links of mutual neighbours of one velocity.

    Mutual ones only, so that bodies side by side with many points stay apart; points of different
    tracks are never linked: walkers side by side stay two. Union-find: each points to one with no
    greater index of its own component; roots are joined in turn.
    """
    n = len(scaled)
    near, apart = np.empty((n, _NEIGHBOURS), np.int64), np.empty(_NEIGHBOURS)
    count, root = np.empty(n, np.int64), np.arange(n)
    C, dv = np.empty((3, 3)), np.empty(3)
    for k in range(n):
        count[k] = nearest(scaled, k, near[k], apart)
    for a in range(n):
        for slot in range(count[a]):
            b, mutual = near[a, slot], False
            for other in range(count[b]):
                mutual |= near[b, other] == a
            if b < a or not mutual or not compatible(points.track_id[a], points.track_id[b]):
                continue
            for i in range(3):
                dv[i] = points.velocity[a, i] - points.velocity[b, i]
                for j in range(3):
                    C[i, j] = points.velocity_cov[a, i, j] + points.velocity_cov[b, i, j]
                C[i, i] += one.turn_mps**2
            if squared_mahalanobis(dv, C) < one.velocity_gate:
                first, second = root_of(root, a), root_of(root, b)
                root[max(first, second)] = min(first, second)
    for k in range(n):
        root[k] = root_of(root, k)
    return root


@part
def root_of(root: IntArray, k: int) -> int:
    """The root of a point's tree."""
    while root[k] != k:
        k = root[k]
    return k


@part
def compatible(track_id: int, other: int) -> bool:
    """Are these not two different tracks? -1 is no track."""
    return track_id == other or track_id < 0 or other < 0


@part
def several(root: IntArray, order: IntArray, start: IntArray) -> int:
    """The number of components with more than one point: their points follow each other in `order`.

    `start` (n + 1,): where each begins.
    """
    count, n_parts = 0, 0
    for first in range(len(root)):
        start[n_parts] = count
        if root[first] == first:
            for k in range(first, len(root)):
                if root[k] == first:
                    order[count] = k
                    count += 1
            if count - start[n_parts] > 1:
                n_parts += 1
            else:
                count -= 1
    start[n_parts] = count
    return n_parts


@part
def split_at_gaps(
    points: PointMotions, one: OneBody, order: IntArray, start: IntArray, n_parts: int,
    values: FloatArray, lateral: FloatArray,
) -> int:  # fmt: skip
    """The number of parts, those that are wider than a body split at their widest gaps.

    Vehicles that start side by side move alike and are linked over the gap between them.
    """
    k = 0
    while k < n_parts:
        index = order[start[k] : start[k + 1]]
        n = len(index)
        sigma = lateral_positions(points, index, n, values, lateral)
        ordered = values_copy(index)
        sort_together(lateral, ordered, n)
        gap, cut = 0.0, 0
        for m in range(1, n):
            if lateral[m] - lateral[m - 1] > gap:
                gap, cut = lateral[m] - lateral[m - 1], m
        if not is_wide(lateral[n - 1] - lateral[0], sigma, one):
            k += 1
            continue
        for m in range(n):
            index[m] = ordered[m]
        for m in range(n_parts, k, -1):
            start[m + 1] = start[m]
        start[k + 1] = start[k] + cut
        n_parts += 1
    return n_parts


@part
def is_wide(across: float, sigma: float, one: OneBody) -> bool:
    """Are the outermost points, each known to `sigma`, farther apart than a body is wide?"""
    return across - 2.0 * one.sigmas * sigma > one.width_m


@part
def values_copy(index: IntArray) -> IntArray:
    """A copy of indices (n,)."""
    out = np.empty(len(index), np.int64)
    for k in range(len(index)):
        out[k] = index[k]
    return out


@part
def lateral_positions(
    points: PointMotions, index: IntArray, n: int, values: FloatArray, lateral: FloatArray
) -> float:
    """Horizontal positions of the first n indexed points across their median velocity, metres.

    They are put into `lateral`; returned is their standard deviation.
    """
    v = median_velocity(points, index, n, values)
    up = points.up
    x, y, z = up[1] * v[2] - up[2] * v[1], up[2] * v[0] - up[0] * v[2], up[0] * v[1] - up[1] * v[0]
    length = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    x, y, z = x / length, y / length, z / length
    for k in range(n):
        p, C = points.p[index[k]], points.cov[index[k]]
        lateral[k] = p[0] * x + p[1] * y + p[2] * z
        values[k] = x * (C[0, 0] * x + C[0, 1] * y + C[0, 2] * z)
        values[k] += y * (C[1, 0] * x + C[1, 1] * y + C[1, 2] * z)
        values[k] += z * (C[2, 0] * x + C[2, 1] * y + C[2, 2] * z)
    return math.sqrt(median(values, n))


@part
def median_velocity(
    points: PointMotions, index: IntArray, n: int, values: FloatArray
) -> tuple[float, float, float]:
    """The median velocity of the first n indexed points, axis by axis."""
    x, y, z = 0.0, 0.0, 0.0
    for a in range(3):
        for k in range(n):
            values[k] = points.velocity[index[k], a]
        m = median(values, n)
        if a == 0:
            x = m
        elif a == 1:
            y = m
        else:
            z = m
    return x, y, z


@part
def may_touch(points: PointMotions, scaled: FloatArray, group: IntArray, other: IntArray) -> bool:
    """Are two sets of points not of two tracks, and of one track or near each other?"""
    track_id, of_other = majority(points.track_id, group), majority(points.track_id, other)
    if not compatible(track_id, of_other):
        return False
    if track_id == of_other and track_id >= 0:  # the far end of a lorry
        return True
    for i in group:
        for j in other:
            d0, d1 = scaled[i, 0] - scaled[j, 0], scaled[i, 1] - scaled[j, 1]
            d2 = scaled[i, 2] - scaled[j, 2]
            if d0 * d0 + d1 * d1 + d2 * d2 <= 1.0:
                return True
    return False


@part
def are_one_body(
    points: PointMotions, one: OneBody, group: IntArray, other: IntArray, values: FloatArray,
    lateral: FloatArray, both: IntArray,
) -> bool:  # fmt: skip
    """Have two sets of points one velocity, and measure together no more across than a body?"""
    v, w = (
        median_velocity(points, group, len(group), values),
        median_velocity(points, other, len(other), values),
    )
    C, dv = np.zeros((3, 3)), np.empty(3)
    for a in range(3):
        dv[a] = v[a] - w[a]
        C[a, a] = one.turn_mps**2
    add_mean_covariance(points.velocity_cov, group, C)
    add_mean_covariance(points.velocity_cov, other, C)
    if not squared_mahalanobis(dv, C) < one.velocity_gate:
        return False
    n = len(group) + len(other)
    for k in range(n):
        both[k] = group[k] if k < len(group) else other[k - len(group)]
    sigma = lateral_positions(points, both, n, values, lateral)
    least, most = lateral[0], lateral[0]
    for k in range(n):
        least, most = min(least, lateral[k]), max(most, lateral[k])
    return not is_wide(most - least, sigma, one)


@part
def add_mean_covariance(covariance: FloatArray, index: IntArray, C: FloatArray) -> None:
    """Add to C (3, 3) the covariance of the mean of the indexed points."""
    for k in index:
        for a in range(3):
            for b in range(3):
                C[a, b] += covariance[k, a, b] / len(index) ** 2


@part
def majority(track_id: IntArray, index: IntArray) -> int:
    """The track that holds most of the indexed points, of several the first; -1 if none does."""
    best, most = -1, 0
    for i in index:
        if track_id[i] >= 0 and track_id[i] != best:
            count = 0
            for j in index:
                count += track_id[j] == track_id[i]
            if count > most or (count == most and track_id[i] < best):
                best, most = track_id[i], count
    return best


cluster_compiled = compiled(cluster, code_folder(Path(__file__)))
