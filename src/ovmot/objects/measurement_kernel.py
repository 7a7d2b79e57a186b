"""The compiled measurements of refined bodies: box, velocity and covariance, ego motion included.

tests/objects/test_measurement_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.sorting import median
from ovmot.objects.refinement_kernel import through_body


class BodyPoints(NamedTuple):
    """M points of bodies, as `RefinedBodies` and `BodyViews` have them."""

    p_world: FloatArray
    by_twist: FloatArray
    cov: FloatArray
    body: IntArray
    inlier: BoolArray


class BodyTwists(NamedTuple):
    """B bodies, as `RefinedBodies` and `BodyViews` have them; `clone` (B,): their earlier poses."""

    twist: FloatArray
    cov: FloatArray
    origin: FloatArray
    span_s: FloatArray
    clone: IntArray


class MeasuredBodies(NamedTuple):
    """Measurements of B bodies, as `ObjectMeasurement` has them; not filled where points are few.

    `members` (K,): the inliers of all bodies, one after the other: `n_members` (B,) of each, from
    the `first` (B,) on. `middle` (B, 3): medians of their points.
    """

    members: IntArray
    first: IntArray
    n_members: IntArray
    position: FloatArray
    middle: FloatArray
    size: FloatArray
    velocity: FloatArray
    T_now_before: FloatArray
    covariance: FloatArray


def measure_bodies(
    points: BodyPoints,
    bodies: BodyTwists,
    T_world_imu: FloatArray,
    P: FloatArray,
    accel_mps2: float,
    min_points: int,
) -> MeasuredBodies:
    """The bodies with at least `min_points` inliers.

    `T_world_imu` (K, 4, 4), the newest last, have the joint covariance P (6K, 6K). A change of
    velocity by `accel_mps2`, a standard deviation, is in the covariance.
    """
    n = len(bodies.twist)
    out = MeasuredBodies(
        np.empty(len(points.body), np.int64), np.empty(n, np.int64), np.zeros(n, np.int64),
        np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, 4, 4)), np.zeros((n, 6, 6)),
    )  # fmt: skip
    J, ego, values, start = np.zeros((6, 6)), np.zeros((6, 6)), np.empty(len(points.body)), 0
    for b in range(n):
        out.first[b] = start
        for k in range(len(points.body)):
            if points.body[k] == b and points.inlier[k]:
                out.members[start + out.n_members[b]] = k
                out.n_members[b] += 1
        own = out.members[start : start + out.n_members[b]]
        start += len(own)
        if len(own) < min_points:
            continue
        box_of(points.p_world, own, bodies.twist[b], b, values, out)
        motion_over_span(bodies, b, out.T_now_before[b])
        by_twist(points, own, bodies, b, J, out)
        add_ego_part(T_world_imu, P, bodies.clone[b], bodies.span_s[b], b, ego, out)
        slack = (0.5 * accel_mps2 * bodies.span_s[b]) ** 2
        for i in range(6):
            for j in range(6):
                out.covariance[b, i, j] += ego[i, j] + (slack if i == j and i >= 3 else 0.0)
    return out


@part
def box_of(
    p: FloatArray, own: IntArray, twist: FloatArray, b: int, values: FloatArray, out: MeasuredBodies
) -> None:
    """Middle, position and size of the box of a body's points along its velocity."""
    speed = math.hypot(twist[3], twist[4])
    c, s = (twist[3] / speed, twist[4] / speed) if speed > 1e-9 else (1.0, 0.0)
    centre = out.position[b]
    for axis in range(3):
        low, high = np.inf, -np.inf
        for k in range(len(own)):
            q = p[own[k]]
            along = (
                q[2] if axis == 2 else (c * q[0] + s * q[1] if axis == 0 else c * q[1] - s * q[0])
            )
            low, high, values[k] = min(low, along), max(high, along), q[axis]
        centre[axis], out.size[b, axis] = 0.5 * (low + high), high - low
        out.middle[b, axis] = median(values, len(own))
    centre[0], centre[1] = c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]


@part
def motion_over_span(bodies: BodyTwists, b: int, T: FloatArray) -> None:
    """T (4, 4): the body's motion over its span, about its origin, exp(s ξ)."""
    xi, unmoved, J, C = np.empty(6), np.eye(4), np.empty((6, 3)), np.empty((3, 4))
    for a in range(6):
        xi[a] = -bodies.span_s[b] * bodies.twist[b, a]
    through_body(xi, unmoved, C, J)
    for a in range(3):
        T[a, 3] = C[a, 3] + bodies.origin[b, a]
        for k in range(3):
            T[a, k] = C[a, k]
            T[a, 3] -= C[a, k] * bodies.origin[b, k]
    T[3, 3] = 1.0


@part
def by_twist(
    points: BodyPoints, own: IntArray, bodies: BodyTwists, b: int, J: FloatArray,
    out: MeasuredBodies,
) -> None:  # fmt: skip
    """Velocity at the position, and the points' part in the covariance of both.

    The position changes with the twist as the mean of its points, the velocity by v + ω x arm.
    """
    xi, n = bodies.twist[b], len(own)
    x = out.position[b, 0] - bodies.origin[b, 0]
    y = out.position[b, 1] - bodies.origin[b, 1]
    z = out.position[b, 2] - bodies.origin[b, 2]
    for i in range(3):
        for a in range(6):
            J[i, a], J[3 + i, a] = 0.0, 1.0 if a == 3 + i else 0.0
            for k in own:
                J[i, a] += points.by_twist[k, i, a] / n
    J[3, 1], J[3, 2], J[4, 0], J[4, 2], J[5, 0], J[5, 1] = z, -y, -z, x, y, -x
    for i in range(3):
        out.velocity[b, i] = xi[3 + i]
        for a in range(3):
            out.velocity[b, i] += J[3 + i, a] * xi[a]
    for i in range(6):
        for j in range(6):
            total = 0.0
            for a in range(6):
                for c in range(6):
                    total += J[i, a] * bodies.cov[b, a, c] * J[j, c]
            if i < 3 and j < 3:
                for k in own:
                    total += points.cov[k, i, j] / n**2
            out.covariance[b, i, j] = total


@part
def add_ego_part(
    T_world_imu: FloatArray, P: FloatArray, clone: int, span_s: float, b: int, ego: FloatArray,
    out: MeasuredBodies,
) -> None:  # fmt: skip
    """`ego` (6, 6): the poses' part, now and at the clone, of position and velocity.

    Points are known in the cameras' frames: δp = -R [p_imu]x δθ + δt moves the body at each time,
    and v = (p_now - p_then) / span. Right perturbations of the poses.
    """
    last, T, J, JP = len(T_world_imu) - 1, out.T_now_before[b], np.zeros((6, 12)), np.empty((6, 12))
    now, then = out.position[b], np.zeros(3)
    for a in range(3):
        for k in range(3):
            then[a] += T[k, a] * (now[k] - T[k, 3])
    for time in range(2):
        pose, p, sign = (last, now, 1.0) if time == 0 else (clone, then, -1.0)
        by_pose(T_world_imu[pose], p, sign / span_s, 6 * time, J)
    for i in range(3):
        for c in range(6):
            J[i, c] = J[3 + i, c] * span_s
    for i in range(6):
        for c in range(12):
            column = 6 * last + c if c < 6 else 6 * (clone - 1) + c
            JP[i, c] = 0.0
            for k in range(6):
                JP[i, c] += J[i, k] * P[6 * last + k, column]
                JP[i, c] += J[i, 6 + k] * P[6 * clone + k, column]
    for i in range(6):
        for j in range(6):
            ego[i, j] = 0.0
            for c in range(12):
                ego[i, j] += JP[i, c] * J[j, c]


@part
def by_pose(T: FloatArray, p: FloatArray, rate: float, first: int, J: FloatArray) -> None:
    """Columns of J (6, 12), from the `first` one on: the velocity by the errors of a pose, which
    are `rate` times the point's."""
    q = np.zeros(3)  # the point in the IMU's axes
    for a in range(3):
        for k in range(3):
            q[a] += T[k, a] * (p[k] - T[k, 3])
    for a in range(3):
        J[3 + a, first] = rate * (T[a, 2] * q[1] - T[a, 1] * q[2])
        J[3 + a, first + 1] = rate * (T[a, 0] * q[2] - T[a, 2] * q[0])
        J[3 + a, first + 2] = rate * (T[a, 1] * q[0] - T[a, 0] * q[1])
        J[3 + a, first + 3 + a] = rate


measure_bodies_compiled = compiled(measure_bodies, code_folder(Path(__file__)))
