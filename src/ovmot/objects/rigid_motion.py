"""Rigid motions of grouped points: sequential RANSAC with closed-form registration."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.clustering import MotionHistory
from ovmot.objects.clustering_kernel import displacement_errors_compiled
from ovmot.objects.rigid_kernel import best_motion_compiled
from ovmot.physics import MAX_YAW_RATE_RPS, gate
from ovmot.settings import ObjectSettings

_SHARE_OF_POINTS = 0.7  # of the row with most points, that a row must hold to be used
_BATCH = 24  # triples drawn at once
_MAX_BATCHES = 4
_MISS = 0.01  # accepted probability that every triple had an outlier


@dataclass(frozen=True, slots=True)
class RigidGroup:
    """Points (indices (n,) of the history) with one motion since its earlier `row`.

    `T_now_then` (4, 4) acts in the present left camera on points that the ego motion has taken
    there.
    """

    index: IntArray
    row: int
    T_now_then: FloatArray


def extract_motions(
    points: MotionHistory,
    group: IntArray,
    rig: StereoRig,
    settings: ObjectSettings,
    rng: np.random.Generator,
) -> tuple[RigidGroup, ...]:
    """The motions in one connected component, in the order in which RANSAC finds them.

    Each motion's inliers are taken out before the next search, since a component may hold two
    bodies.
    """
    found = []
    remaining = group
    T_cam1_cam0 = np.ascontiguousarray(rig.T_cam1_cam0)
    while len(remaining) >= settings.min_points:
        # An acceleration is common to the points of a body: it does not limit the span here.
        row = best_row(points, remaining, accel_sigma=0.0)
        seen = remaining[points.weight[row, remaining, 0, 0] > 0.0]
        if len(seen) < settings.min_points:
            break
        T, inlier = ransac_motion(points, seen, row, T_cam1_cam0, rng)
        if inlier.sum() < settings.min_points:
            break
        found.append(RigidGroup(seen[inlier], row, T))
        remaining = np.setdiff1d(remaining, seen[inlier], assume_unique=True)
    return tuple(found)


def best_row(points: MotionHistory, index: IntArray, accel_sigma: float) -> int:
    """The earlier row with the least expected squared error of the velocity of points (n,).

    The part of the points' noise falls with the span and with their number; that of an
    acceleration of standard deviation `accel_sigma`, m/s², grows with the span.
    """
    trace, seen = displacement_errors_compiled(points.information, points.weight, index)
    span = points.history.span_s
    error = trace / span**2 + 2.0 * (0.5 * accel_sigma * span) ** 2
    return int(np.argmin(np.where(seen >= _SHARE_OF_POINTS * seen.max(), error, np.inf)))


def ransac_motion(
    points: MotionHistory,
    index: IntArray,
    row: int,
    T_cam1_cam0: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, BoolArray]:
    """Motion (4, 4) and inliers (n,) of the points (n,), all seen in `row`.

    Triples propose motions (`rigid_kernel`), scored by truncated Mahalanobis distances of the
    reprojection (P. Torr, A. Zisserman, MLESAC, 2000); drawing stops when a triple without outlier
    is likely to have been drawn (M. Fischler, R. Bolles, 1981).
    """
    n = len(index)
    p, q = points.predicted[row, index], points.p_cam0[index]
    sigma = np.sqrt(points.cov_cam0[index, 2, 2])
    seen, weight = points.history.now[index], points.weight[row, index]
    least_cosine = float(np.cos(MAX_YAW_RATE_RPS * points.history.span_s[row]))
    # a rotation has three more unknowns, and must explain that much more
    inlier_gate, turn_penalty = gate(4, 0.999), gate(3, 0.99)
    best_cost, best_T = np.inf, np.eye(4)
    best = np.zeros(n, dtype=np.bool_)
    for drawn in range(_BATCH, _BATCH * _MAX_BATCHES + 1, _BATCH):
        cost, T, inlier = best_motion_compiled(
            _triples(n, rng), p, q, sigma, seen, weight, T_cam1_cam0, least_cosine, inlier_gate,
            turn_penalty,
        )  # fmt: skip
        if cost < best_cost:
            best_cost, best_T, best = cost, T, inlier
        share = np.count_nonzero(best) / n
        if (1.0 - share**3) ** drawn < _MISS:
            break
    return best_T, best


def _triples(n: int, rng: np.random.Generator) -> IntArray:
    """Triples (_BATCH, 3) of different indices below n."""
    order = np.argsort(rng.random((_BATCH, n)), axis=1)
    return np.ascontiguousarray(order[:, :3], np.int64)
