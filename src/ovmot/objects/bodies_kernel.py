"""Compiled questions about measured bodies: can it be one, does it move, is it part of another?

tests/objects/test_bodies_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import eigen_symmetric, squared_mahalanobis
from ovmot.kernels.sorting import median, sort_together
from ovmot.kernels.stereo import transform
from ovmot.objects.clustering_kernel import OneBody, compatible, majority
from ovmot.objects.measurement_kernel import MeasuredBodies

_FEW = 4  # points that may be a part of a body of another group


class RoadUser(NamedTuple):
    """What a body must be: of `min_points`, at `min_speed_mps` or faster.

    A direction in which the velocity is known no better than `max_sigma_mps` does not count. It is
    at most `highest_m` above the camera, where the road has no slope, and more by `max_slope` of
    its distance; and at least `least_height_m` above the ground that static
    points within `ground_radius_m` show.
    """

    min_points: int
    min_speed_mps: float
    max_sigma_mps: float
    highest_m: float
    max_slope: float
    least_height_m: float
    ground_radius_m: float


class Grouped(NamedTuple):
    """`point` (M,): indices of the bodies' points, whose `track_id` (all,) is -1 for none.

    `group` (B,): cluster of each body.
    """

    point: IntArray
    track_id: IntArray
    group: IntArray


def velocity_distance(error: FloatArray, covariance: FloatArray, spread: float) -> float:
    """Squared Mahalanobis distance of an error (3,), `spread` added to each axis' deviation."""
    C = covariance.copy()
    for a in range(3):
        C[a, a] += spread * spread
    return float(squared_mahalanobis(error, C))


def can_be_bodies(
    measured: MeasuredBodies,
    p_world: FloatArray,
    p_cam0: FloatArray,
    is_static: BoolArray,
    T_world_cam0: FloatArray,
    user: RoadUser,
) -> BoolArray:
    """Which of the measured bodies (B,) are a road user's size and place, and fast enough.

    `p_world` (M, 3): the bodies' points; `p_cam0` (N, 3), `is_static` (N,): the frame's points.
    """
    n_bodies, static = len(measured.first), world_points(p_cam0, is_static, T_world_cam0)
    out = np.empty(n_bodies, np.bool_)
    for b in range(n_bodies):
        own = measured.members[measured.first[b] : measured.first[b] + measured.n_members[b]]
        out[b] = (
            len(own) >= user.min_points
            and not is_aloft(measured.middle[b], T_world_cam0, user)
            and is_fast(measured.velocity[b], measured.covariance[b], user)
            and not height_above_ground(p_world, own, static, user) < user.least_height_m
        )
    return out


@part
def world_points(p_cam0: FloatArray, chosen: BoolArray, T_world_cam0: FloatArray) -> FloatArray:
    """The chosen ones of points (N, 3) that are known, in the world."""
    out, count = np.empty((len(p_cam0), 3)), 0
    for n in range(len(p_cam0)):
        if chosen[n] and math.isfinite(p_cam0[n, 2]):
            transform(T_world_cam0, p_cam0[n], out[count])
            count += 1
    return out[:count]


@part
def is_aloft(middle: FloatArray, T_world_cam0: FloatArray, user: RoadUser) -> bool:
    """Is a body whose points have this median (3,) higher than road users are?

    Repeated windows that are all matched to their neighbours appear at ρ times their distance, and
    seem to move at ρ - 1 times the rig's speed, towards it: a rigid motion, but at a wrong height.
    """
    x, y = middle[0] - T_world_cam0[0, 3], middle[1] - T_world_cam0[1, 3]
    above = middle[2] - T_world_cam0[2, 3]
    return bool(above > user.highest_m + user.max_slope * math.hypot(x, y))


@part
def known_part(
    velocity: FloatArray, covariance: FloatArray, max_sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Components (k,) of a velocity (3,) along those principal axes in which it is known to
    `max_sigma`, and their variances (k,); `covariance` (6, 6) of position and velocity.

    The unknown part of a far body is along the ray, where the errors of patches are not white: they
    drift together.
    """
    values, axes, C, known = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), 0
    for a in range(3):
        for c in range(3):
            C[a, c] = covariance[3 + a, 3 + c]
    eigen_symmetric(C, values, axes)
    component = np.empty(3)
    for k in range(3):
        if values[k] < max_sigma**2:
            component[known], values[known] = 0.0, values[k]
            for a in range(3):
                component[known] += axes[a, k] * velocity[a]
            known += 1
    return component[:known], values[:known]


@part
def is_fast(velocity: FloatArray, covariance: FloatArray, user: RoadUser) -> bool:
    """Is the known part of a body's velocity (3,) fast enough to be a measurement?"""
    known, _ = known_part(velocity, covariance, user.max_sigma_mps)
    squared = 0.0
    for k in range(len(known)):
        squared += known[k] ** 2
    return bool(squared > user.min_speed_mps**2)


@part
def height_above_ground(
    p_world: FloatArray, own: IntArray, static: FloatArray, user: RoadUser
) -> float:
    """How far the highest tenth of a body's `own` points begins above the ground; infinite if not
    known.

    Patches of a road seen at a grazing angle drift together, as a body would. The ground is the
    height below which a tenth of the static points (M, 3) around the points' mean are, if they are
    as many as make a body.
    """
    x, y, n = 0.0, 0.0, 0
    tops, near = np.empty(len(own)), np.empty(len(static))
    for k in range(len(own)):
        x += p_world[own[k], 0] / len(own)
        y += p_world[own[k], 1] / len(own)
        tops[k] = p_world[own[k], 2]
    for k in range(len(static)):
        if (static[k, 0] - x) ** 2 + (static[k, 1] - y) ** 2 < user.ground_radius_m**2:
            near[n] = static[k, 2]
            n += 1
    if n < user.min_points:
        return math.inf
    top = ranked(tops, len(own), len(own) - 1 - len(own) // 10)
    return top - ranked(near, n, n // 10)


@part
def ranked(values: FloatArray, n: int, rank: int) -> float:
    """The value of this rank, from 0, among the first n, which are sorted then."""
    median(values, n)
    return float(values[rank])


def distance_from_rest(
    velocity: FloatArray, covariance: FloatArray, max_sigma: float
) -> tuple[FloatArray, IntArray]:
    """Squared Mahalanobis distance of velocities (B, 3) from zero, in the directions in which they
    are known to `max_sigma`, and their number (B,).

    `covariance` (B, 6, 6): of position and velocity.
    """
    distance, dof = np.zeros(len(velocity)), np.empty(len(velocity), np.int64)
    for b in range(len(velocity)):
        known, variance = known_part(velocity[b], covariance[b], max_sigma)
        dof[b] = len(known)
        for k in range(len(known)):
            distance[b] += known[k] ** 2 / variance[k]
    return distance, dof


def without_parts(
    measured: MeasuredBodies,
    p_world: FloatArray,
    moves: BoolArray,
    points: Grouped,
    one: OneBody,
) -> IntArray:
    """Those of the bodies that move (B,) which are no part of a larger one, the largest first.

    A part lies at the larger body and has its velocity, is not another track's, and comes from the
    same group or has few points.
    """
    n, count, n_kept = len(moves), 0, 0
    order, key, track_id = np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    own = np.empty(len(points.point), np.int64)
    for b in range(n):
        if moves[b]:  # stable: of one size the first comes first
            order[count], key[count] = b, b - float(n) * measured.n_members[b]
            count += 1
            for k in range(measured.n_members[b]):
                own[k] = points.point[measured.members[measured.first[b] + k]]
            track_id[b] = majority(points.track_id, own[: measured.n_members[b]])
    sort_together(key, order, count)
    for k in range(count):
        body, alone = order[k], True
        for j in range(n_kept):
            larger = order[j]
            related = points.group[body] == points.group[larger]
            if (
                (related or measured.n_members[body] <= _FEW)
                and compatible(track_id[body], track_id[larger])
                and is_part(measured, p_world, body, larger, one)
            ):
                alone = False
                break
        if alone:
            order[n_kept] = body
            n_kept += 1
    return order[:n_kept]


@part
def is_part(
    measured: MeasuredBodies, p_world: FloatArray, body: int, larger: int, one: OneBody
) -> bool:
    """Has a body the velocity of a larger one, and lies at it?

    To the covariance of the difference comes the spread of velocities in a turning body.
    """
    v, dv = measured.velocity, np.empty(3)
    of_place, of_velocity = np.empty((3, 3)), np.empty((3, 3))
    both = measured.covariance
    for a in range(3):
        dv[a] = v[larger, a] - v[body, a]
        for c in range(3):
            of_place[a, c] = both[body, a, c] + both[larger, a, c]
            of_velocity[a, c] = both[body, 3 + a, 3 + c] + both[larger, 3 + a, 3 + c]
    for a in range(3):
        of_velocity[a, a] += one.turn_mps**2
    if not squared_mahalanobis(dv, of_velocity) < one.velocity_gate:
        return False
    values, axes = np.empty(3), np.empty((3, 3))
    eigen_symmetric(of_place, values, axes)
    reach = one.radius_m + one.sigmas * math.sqrt(values[2])
    return bool(least_distance(measured, p_world, body, larger) < reach)


@part
def least_distance(measured: MeasuredBodies, p: FloatArray, body: int, other: int) -> float:
    """The least distance between points of two bodies, of all points (M, 3)."""
    least = np.inf
    for i in range(measured.n_members[body]):
        n = measured.members[measured.first[body] + i]
        for j in range(measured.n_members[other]):
            m = measured.members[measured.first[other] + j]
            x, y, z = p[n, 0] - p[m, 0], p[n, 1] - p[m, 1], p[n, 2] - p[m, 2]
            least = min(least, x * x + y * y + z * z)
    return math.sqrt(least)


_FOLDER = code_folder(Path(__file__))
can_be_bodies_compiled = compiled(can_be_bodies, _FOLDER)
distance_from_rest_compiled = compiled(distance_from_rest, _FOLDER)
without_parts_compiled = compiled(without_parts, _FOLDER)
