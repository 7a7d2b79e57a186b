"""Rigid motions among grouped points: RANSAC with closed-form registration, one after another."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import ObjectSettings
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.registration import register_rigid, triangle_height
from ovmot.geometry.triangulation import inverse_3x3
from ovmot.objects.grouping import MotionHistory

_GATE = 18.47  # 99.9 % of chi-squared with 4 degrees of freedom
_SHARE_OF_POINTS = 0.7  # of those that the best row holds, that any row in use must hold
_BATCH = 24  # triples drawn at once
_MAX_BATCHES = 4
_MISS = 0.01  # accepted probability that no triple was free of outliers
_HEIGHT_SIGMAS = 4.0  # a triangle flatter than this many sigmas of its corners tells no rotation
_MAX_RATE = 2.0  # rad/s, beyond what a body on a road turns by
_TURN_PENALTY = 11.34  # a rotation must explain as much more: 99 % of chi-squared, 3 more unknowns


@dataclass(frozen=True, slots=True)
class RigidGroup:
    """Points (indices (n,) of the history) with one motion since the earlier `row` of it.

    `T_now_then` (4, 4) acts in the present left camera on points that the ego motion carried there.
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
    """The motions in one connected component, that with most points first."""
    found = []
    left = group
    while len(left) >= settings.min_points:
        # How a body accelerates does not tell its points apart: look as far back as helps.
        row = best_row(points, left, accel_sigma=0.0)
        seen = left[points.weight[row, left, 0, 0] > 0.0]
        if len(seen) < settings.min_points:
            break
        T, inlier = ransac_motion(points, seen, row, rig, rng)
        if inlier.sum() < settings.min_points:
            break
        found.append(RigidGroup(seen[inlier], row, T))
        left = np.setdiff1d(left, seen[inlier], assume_unique=True)
    return tuple(found)


def best_row(points: MotionHistory, index: IntArray, accel_sigma: float) -> int:
    """The earlier row from which the velocity of points (n,) is known best.

    Noise of the points falls with the span and with their number, what the body may have
    accelerated (standard deviation in m/s²) grows with the span: the least expected squared error.
    """
    information = points.information[:, index].sum(1) + 1e-6 * np.eye(3)
    span = points.comparison.span_s
    error = np.trace(inverse_3x3(information), axis1=1, axis2=2) / span**2
    error = error + 2.0 * (0.5 * accel_sigma * span) ** 2
    seen = (points.weight[:, index, 0, 0] > 0.0).sum(1)
    return int(np.argmin(np.where(seen >= _SHARE_OF_POINTS * seen.max(), error, np.inf)))


def ransac_motion(
    points: MotionHistory, index: IntArray, row: int, rig: StereoRig, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Motion (4, 4) and inliers (n,) of the points (n,), all seen in `row`.

    Each triple proposes its mean translation and, unless it is degenerate, its rigid motion. All
    proposals are scored at once by truncated covariance-scaled reprojection errors (P. Torr, A.
    Zisserman, MLESAC, 2000); drawing stops when a triple without outlier was likely (M. Fischler,
    R. Bolles, 1981).
    """
    comparison, n = points.comparison, len(index)
    p, q = comparison.predicted[row, index], points.p_cam0[index]
    W = points.weight[row, index]
    sigma = np.sqrt(points.cov_cam0[index, 2, 2])
    best_cost, best_T = np.inf, np.eye(4)
    best = np.zeros(n, dtype=np.bool_)
    for drawn in range(_BATCH, _BATCH * _MAX_BATCHES + 1, _BATCH):
        triple = _triples(n, rng)
        T, penalty = _proposals(p[triple], q[triple], sigma[triple], comparison.span_s[row])
        distance = _distances(T, p, points.history.now[index], W, rig.T_cam1_cam0)
        cost = np.minimum(distance, _GATE).sum(1) + penalty
        k = int(np.argmin(cost))
        if cost[k] < best_cost:
            best_cost, best_T, best = float(cost[k]), T[k], distance[k] < _GATE
        share = float(best.mean())
        if (1.0 - share**3) ** drawn < _MISS:
            break
    return best_T, best


def _distances(
    T: FloatArray, p: FloatArray, seen: FloatArray, W: FloatArray, T_cam1_cam0: FloatArray
) -> FloatArray:
    """Squared distances (H, n) of points (n, 3) moved by T (H, 4, 4) from where they are seen.

    `seen` (n, 4) in both views, `W` (n, 4, 4) its weights.
    """
    q = p @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    q1 = q @ T_cam1_cam0[:3, :3].T + T_cam1_cam0[:3, 3]
    h = np.concatenate([q[..., :2] / q[..., 2:], q1[..., :2] / q1[..., 2:]], axis=-1)
    r = np.swapaxes(seen - h, 0, 1)  # each point's weights meet all its residuals at once
    distance: FloatArray = ((r @ W) * r).sum(-1).T
    return distance


def _triples(n: int, rng: np.random.Generator) -> IntArray:
    """Triples (_BATCH, 3) of different indices below n."""
    order = np.argsort(rng.random((_BATCH, n)), axis=1)
    return np.asarray(order[:, :3], np.int64)


def _proposals(
    p: FloatArray, q: FloatArray, sigma: FloatArray, span_s: float
) -> tuple[FloatArray, FloatArray]:
    """Motions (H, 4, 4) of triples p -> q (B, 3, 3), and what each must pay for its freedom (H,).

    `sigma` (B, 3): standard deviation of each corner.
    """
    weight = 1.0 / sigma**2
    t = ((q - p) * weight[..., None]).sum(1) / weight.sum(1)[:, None]
    shift = se3.make(np.eye(3), t)
    wide = triangle_height(q) > _HEIGHT_SIGMAS * sigma.max(1)
    if not wide.any():
        return shift, np.zeros(len(shift))
    rigid = register_rigid(p[wide], q[wide])
    cosine = 0.5 * (np.trace(rigid[:, :3, :3], axis1=1, axis2=2) - 1.0)
    rigid = rigid[cosine > np.cos(_MAX_RATE * span_s)]
    penalty = np.concatenate([np.zeros(len(shift)), np.full(len(rigid), _TURN_PENALTY)])
    return np.concatenate([shift, rigid]), penalty
