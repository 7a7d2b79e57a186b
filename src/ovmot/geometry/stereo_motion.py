"""Robust motion between two stereo views of the same points."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.stereo_motion_kernel import (
    count_inliers_compiled,
    motion_and_points_system_compiled,
    motion_system_compiled,
)
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.physics import gate

MIN_POINTS = 8
"""Points that must agree on a motion."""
_INLIER_PROBABILITY = 0.99
_HUBER = 2.0  # standard deviations, from which on residuals count linearly
_ITERATIONS = 8
_SETTLED = 1e-6
"""Squared Mahalanobis length of the last step: a thousandth of a standard deviation."""


@dataclass(frozen=True, slots=True)
class StereoMotion:
    """`T_now_before` (4, 4) of the left camera, its covariance (6, 6) in rad and m, inliers (N,).

    Errors are (rotation, translation) with the rotation on the left, the translation additive:
    R_true = exp(δθ) R, t_true = t + δt.
    """

    T_now_before: FloatArray
    covariance: FloatArray
    inlier: BoolArray


def solve_stereo_motion(
    before: FloatArray,
    now: FloatArray,
    T_cam1_cam0: FloatArray,
    R_now_before: FloatArray,
    sigma: FloatArray,
    rotation_sigma: float,
    *,
    max_motions: int = 1,
) -> StereoMotion | None:
    """Motion of the left camera by stereo points seen as `before` (N, 4) and `now` (N, 4).

    `before`, `now`: normalized coordinates, left x, y and right x, y, NaN where unseen; `sigma`
    (4,): their standard deviations. `R_now_before` (3, 3): prior rotation of the left camera, with
    standard deviation `rotation_sigma`, rad. None where fewer than 8 points agree.

    With the prior rotation each point alone proposes a translation. The proposal with most points
    inside their covariance-scaled gate is refined by iteratively reweighted Gauss-Newton: first the
    motion alone, with a gate as wide as the rotation is uncertain, then together with the points.

    Such a gate lets far points agree with a near body as well as with the world. Where there may be
    bodies, up to `max_motions` are refined, each one proposed by the points that those before do
    not explain, and the one that explains the points best is taken (`_unexplained`).
    """
    T_cam1_cam0, sigma = np.array(T_cam1_cam0, order="C"), np.array(sigma, order="C")
    p_before = triangulate_stereo(before, T_cam1_cam0)
    p_now = triangulate_stereo(now, T_cam1_cam0)
    valid: BoolArray = np.isfinite(np.concatenate([p_before, p_now], axis=1)).all(axis=1)
    points = _Points(before[valid], now[valid], p_before[valid], p_now[valid])
    prior = _Prior(R_now_before, rotation_sigma)
    best = _motion_of(points, np.ones(len(points.p), dtype=np.bool_), prior, T_cam1_cam0, sigma)
    if best is None:
        return None
    if max_motions > 1:
        best = _best_of_more(best, max_motions - 1, points, prior, T_cam1_cam0, sigma)
    T, information, inlier = best
    all_inliers = np.zeros(len(valid), dtype=np.bool_)
    all_inliers[valid] = inlier
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return StereoMotion(T, covariance, all_inliers)


class _Points(NamedTuple):
    """N stereo points: views (N, 4) before and now, and positions p and q (N, 3), m, by them."""

    before: FloatArray
    now: FloatArray
    p: FloatArray
    q: FloatArray


class _Prior(NamedTuple):
    """Rotation (3, 3) of the left camera, and its standard deviation, rad."""

    R: FloatArray
    sigma: float


def _motion_of(
    points: _Points, proposing: BoolArray, prior: _Prior, T_cam1_cam0: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """The motion (4, 4) of the points `proposing` (N,), its information (6, 6), and which of all
    points (N,) are its inliers; None of fewer than 8."""
    if proposing.sum() < MIN_POINTS:
        return None
    p, q, z = points.p[proposing], points.q[proposing], points.now[proposing]
    C = stereo_covariance(p, T_cam1_cam0, sigma)
    # the uncertainty of the prior rotation widens the gate
    A = prior.sigma * so3.hat(p)
    W = _inverse_covariances(C + A @ np.swapaxes(A, -1, -2), prior.R, q, T_cam1_cam0, sigma)
    t, n_inliers = _best_translation(p, q, z, W, prior.R, T_cam1_cam0)
    if n_inliers < MIN_POINTS:
        return None
    T = _refine(se3.make(prior.R, t), p, z, W, prior.R, prior.sigma, T_cam1_cam0)
    if not proposing.all():  # by themselves first: most of all points may be another body's
        T, _, _ = _refine_with_points(
            T, points.before[proposing], z, p, sigma, prior.R, prior.sigma, T_cam1_cam0
        )
    T, information, inlier = _refine_with_points(
        T, points.before, points.now, points.p, sigma, prior.R, prior.sigma, T_cam1_cam0
    )
    return (T, information, inlier) if inlier.sum() >= MIN_POINTS else None


_Motion = tuple[FloatArray, FloatArray, BoolArray]
"""Of `_motion_of`."""


def _best_of_more(
    best: _Motion, n_more: int, points: _Points, prior: _Prior, T_cam1_cam0: FloatArray,
    sigma: FloatArray,
) -> _Motion:  # fmt: skip
    """That motion, or one of `n_more`, which explains the points best."""
    error = _unexplained(best[0], points, T_cam1_cam0, sigma)
    least, left = error.sum(), error >= 1.0
    for _ in range(n_more):
        found = _motion_of(points, left, prior, T_cam1_cam0, sigma)
        if found is None:
            break
        error = _unexplained(found[0], points, T_cam1_cam0, sigma)
        left &= error >= 1.0
        if error.sum() < least:
            best, least = found, error.sum()
    return best


def _unexplained(
    T: FloatArray, points: _Points, T_cam1_cam0: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Squared Mahalanobis distance (N,) of each point from a motion, in units of its gate, 1 beyond
    (the cost of MSAC; P. Torr and A. Zisserman, "MLESAC", CVIU 2000)."""
    C = stereo_covariance(points.p, T_cam1_cam0, sigma)
    W = _inverse_covariances(C, T[:3, :3], points.q, T_cam1_cam0, sigma)
    r = points.now - project_stereo(se3.apply(T, points.p), T_cam1_cam0)[0]
    squared = np.einsum("na,nab,nb->n", r, W, r)
    unexplained = np.minimum(squared / gate(4, _INLIER_PROBABILITY), 1.0)
    return np.asarray(np.where(np.isfinite(squared), unexplained, 1.0))


def motion_is_significant(motion: StereoMotion, min_motion_m: float) -> bool:
    """Is the translation longer than `min_motion_m`, and significant at 99.9 %?"""
    t = motion.T_now_before[:3, 3]
    distance = float(t @ np.linalg.solve(motion.covariance[3:, 3:], t))
    return float(np.linalg.norm(t)) > min_motion_m and distance > gate(3, 0.999)


def _inverse_covariances(
    C: FloatArray, R: FloatArray, q: FloatArray, T_c1_c0: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Inverse covariances (N, 4, 4) of the reprojection of points of covariance C (N, 3, 3).

    R rotates C into the view now; derivatives are those at the points q (N, 3) observed now.
    """
    _, J = project_stereo(q, T_c1_c0)
    S = J @ (R @ C @ R.T) @ np.swapaxes(J, -1, -2) + np.diag(sigma**2)
    return np.asarray(np.linalg.inv(S), np.float64)


def _best_translation(
    p: FloatArray, q: FloatArray, z: FloatArray, W: FloatArray, R: FloatArray, T_c1_c0: FloatArray,
    *, max_proposals: int = 80,
) -> tuple[FloatArray, int]:  # fmt: skip
    """The proposal with most inliers, and their number; near points propose, since their depth is
    known best."""
    rotated = p @ R.T
    nearest = np.argsort(q[:, 2], kind="stable")[:max_proposals]
    proposals = q[nearest] - rotated[nearest]
    bound = gate(4, _INLIER_PROBABILITY)
    count = count_inliers_compiled(proposals, rotated, z, W, T_c1_c0, bound)
    best = int(np.argmax(count))
    return proposals[best], int(count[best])


def _refine(
    T: FloatArray,
    p: FloatArray,
    z: FloatArray,
    W: FloatArray,
    R_prior: FloatArray,
    rotation_sigma: float,
    T_c1_c0: FloatArray,
) -> FloatArray:
    """Gauss-Newton on the motion with Huber weights; points beyond twice the gate are left out."""
    bound = 2.0 * gate(4, _INLIER_PROBABILITY)
    for _ in range(_ITERATIONS):
        information, gradient = motion_system_compiled(T, p, z, W, T_c1_c0, bound, _HUBER)
        information[:3, :3] += np.eye(3) / rotation_sigma**2
        gradient[:3] += so3.log(R_prior @ T[:3, :3].T) / rotation_sigma**2
        solved = np.linalg.solve(information + 1e-9 * np.eye(6), gradient)
        step = np.asarray(solved, np.float64)
        T = se3.make(so3.exp(step[:3]) @ T[:3, :3], T[:3, 3] + step[3:])
        if step @ information @ step < _SETTLED:
            break
    return T


def _refine_with_points(
    T: FloatArray,
    before: FloatArray,
    now: FloatArray,
    p: FloatArray,
    sigma: FloatArray,
    R_prior: FloatArray,
    rotation_sigma: float,
    T_c1_c0: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Motion, its information (6, 6) and inliers: Gauss-Newton on the motion and all points.

    Points fixed where stereo triangulates them make the motion too short, since the errors of their
    depth are not symmetric. A point is (x, y, 1/z) in the earlier left view, and is eliminated from
    the normal equations (Schur complement; B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1).
    """
    bound = gate(5, _INLIER_PROBABILITY)  # two stereo views without the point's coordinates
    information, inlier = np.eye(6), np.zeros(len(p), dtype=np.bool_)
    point = np.concatenate([before[:, :2], 1.0 / p[:, 2:]], axis=1)
    for _ in range(_ITERATIONS):
        new, gradient, inlier, c, B = motion_and_points_system_compiled(
            T, point, before, now, sigma, T_c1_c0, bound, _HUBER
        )
        if not inlier.any():  # the wide gate has mixed two motions into one of neither
            break
        information = new
        information[:3, :3] += np.eye(3) / rotation_sigma**2
        gradient[:3] += so3.log(R_prior @ T[:3, :3].T) / rotation_sigma**2
        step = np.asarray(np.linalg.solve(information, gradient), np.float64)
        point = point + c - B @ step
        T = se3.make(so3.exp(step[:3]) @ T[:3, :3], T[:3, 3] + step[3:])
        if step @ information @ step < _SETTLED:
            break
    return T, information, inlier
