"""The compiled refinement of bodies around its normal equations: weights before, places after.

tests/objects/test_refined_bodies_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.kernels.small_matrices import invert_definite
from ovmot.objects.body_views_kernel import BodyViews
from ovmot.objects.refinement_kernel import Refined, WeightedViews, refine
from ovmot.segmentation.history_kernel import inverse_motion


class StereoPixels(NamedTuple):
    """The stereo extrinsics (4, 4), `focal` lengths (4,) in pixels, and the noise of the pixels.

    `sigma_px`, `drift_per_frame_px`, `drift_per_flow`: as `PixelNoise`.
    """

    T_cam1_cam0: FloatArray
    focal: FloatArray
    sigma_px: float
    drift_per_frame_px: float
    drift_per_flow: float


class RefinedBodies(NamedTuple):
    """`twist` (B, 6) as (ω, v), `covariance` (B, 6, 6), points `p_world` (M, 3), `inlier` (M,).

    `point_cov` (M, 3, 3): of the points for given twists; `by_twist` (M, 3, 6): their derivative by
    it.
    """

    twist: FloatArray
    covariance: FloatArray
    p_world: FloatArray
    inlier: BoolArray
    point_cov: FloatArray
    by_twist: FloatArray


def refine_bodies(
    views: BodyViews,
    may_turn: BoolArray,
    pixels: StereoPixels,
    yaw_sigma_rps: float,
    tilt_sigma_rps: float,
    huber_gates: FloatArray,
    cost_gates: FloatArray,
) -> RefinedBodies:
    """The bodies after the bundle adjustment; arguments as for `refinement.refine_bodies`.

    Standard deviations of the turn rates' priors, and the cost (dof + 1,) of a point from which its
    loss is linear, and from which it is an outlier.
    """
    n_bodies, n_points = len(views.twist), len(views.body)
    point, prior = np.empty((n_points, 3)), np.zeros((n_bodies, 6))
    for m in range(n_points):
        point[m, 2] = 1.0 / views.p_cam0[m, 2]
        for a in range(2):
            point[m, a] = views.p_cam0[m, a] * point[m, 2]
    for b in range(n_bodies):
        for a in range(3):
            free = may_turn[b] and a == 2
            prior[b, a] = (yaw_sigma_rps if free else tilt_sigma_rps) ** -2.0
    weighted = weighted_views(views, pixels)
    dof, huber, bound = np.empty(n_points), np.empty(n_points), np.empty(n_points)
    for m in range(n_points):
        own = -3
        for v in range(len(views.seen)):
            own += 4 * (weighted.by_sum[v, m] > 0.0)
        dof[m], huber[m], bound[m] = own, math.sqrt(huber_gates[own]), cost_gates[own]
    found = refine(point, views.twist, weighted, huber, bound, prior)
    p_world, point_cov, by_twist = world_points(found, views)
    for b in range(n_bodies):
        widen = variance_factor(found, views, dof, b)
        covariance = found.information[b]
        invert_definite(covariance)
        for i in range(6):
            for j in range(6):
                covariance[i, j] *= widen
    return RefinedBodies(found.twist, found.information, p_world, found.inlier, point_cov, by_twist)


@part
def weighted_views(views: BodyViews, pixels: StereoPixels) -> WeightedViews:
    """The views with their weights, and with transforms about the bodies' origins.

    A tracked patch drifts on the surface, and the right match is that of the drifted left one. So
    each pixel has its own noise of variance σ², and both cameras share a drift of variance c since
    the earlier times. Sum and difference of the cameras are independent, with variances σ² + 2 c
    and σ².
    """
    seen, focal, sigma = views.seen, pixels.focal, pixels.sigma_px
    n_views, n_points = seen.shape[:2]
    n_bodies, now = len(views.origin), n_views - 1
    by_difference, by_sum = np.zeros((n_views, n_points)), np.zeros((n_views, n_points))
    for v in range(n_views):
        for m in range(n_points):
            total = seen[v, m, 0] + seen[v, m, 1] + seen[v, m, 2] + seen[v, m, 3]
            if math.isfinite(total):
                du = (seen[v, m, 0] - seen[now, m, 0]) * focal[0]
                dv = (seen[v, m, 1] - seen[now, m, 1]) * focal[1]
                drift = views.track_length[v, views.body[m]] * pixels.drift_per_frame_px**2
                drift += pixels.drift_per_flow**2 * (du * du + dv * dv)
                by_difference[v, m] = math.sqrt(0.5) / sigma
                by_sum[v, m] = math.sqrt(0.5) / math.sqrt(sigma**2 + 2.0 * drift)
    into_view, out_of_now = np.zeros((n_views, n_bodies, 4, 4)), np.empty((n_bodies, 4, 4))
    for b in range(n_bodies):
        for v in range(n_views):
            about_origin(views.T_world_cam0[v, b], views.origin[b], into_view[v, b], out_of_now[b])
    return WeightedViews(
        seen, by_difference, by_sum, views.body, views.span_s, into_view, out_of_now,
        pixels.T_cam1_cam0, focal,
    )  # fmt: skip


@inlined_part
def about_origin(
    T_world_cam0: FloatArray, origin: FloatArray, into: FloatArray, out_of: FloatArray
) -> None:
    """Transforms (4, 4) from world axes about the origin (3,) into the camera, and out of it."""
    for a in range(3):
        for c in range(4):
            out_of[a, c] = T_world_cam0[a, c]
        out_of[a, 3] -= origin[a]
        out_of[3, a] = 0.0
    out_of[3, 3] = 1.0
    inverse_motion(out_of, into)


@part
def variance_factor(found: Refined, views: BodyViews, dof: FloatArray, b: int) -> float:
    """Variance of body b's noise by the residuals as a share of the prior one, at least 1.

    `dof` (M,): degrees of freedom of each point. Noise above the prior one widens the covariance.
    """
    cost, own = 0.0, 0.0
    for m in range(len(dof)):
        if views.body[m] == b and found.inlier[m]:
            cost += found.weight[m] * found.cost[m]
            own += dof[m]
    return max(1.0, cost / max(own, 1.0))


@part
def world_points(found: Refined, views: BodyViews) -> tuple[FloatArray, FloatArray, FloatArray]:
    """World points (M, 3), covariance (M, 3, 3) and derivative by twists (M, 3, 6).

    The refined points are (x, y, 1/z) in the left camera of now, with covariance `N_inverse`; minus
    `K`, transposed, is their derivative.
    """
    n, last = len(found.point), len(views.seen) - 1
    p, C, by_twist = np.empty((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 6))
    J, JN = np.empty((3, 3)), np.empty((3, 3))
    for m in range(n):
        point, T = found.point[m], views.T_world_cam0[last, views.body[m]]
        z = 1.0 / point[2]
        for a in range(3):
            ray = T[a, 0] * point[0] + T[a, 1] * point[1] + T[a, 2]
            p[m, a] = ray * z + T[a, 3]
            J[a, 0], J[a, 1], J[a, 2] = T[a, 0] * z, T[a, 1] * z, -ray * z * z
        for a in range(3):
            for b in range(3):
                JN[a, b] = 0.0
                for c in range(3):
                    JN[a, b] += J[a, c] * found.N_inverse[m, c, b]
            for b in range(6):
                for c in range(3):
                    by_twist[m, a, b] -= J[a, c] * found.K[m, b, c]
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    C[m, a, b] += JN[a, c] * J[b, c]
    return p, C, by_twist


refine_bodies_compiled = compiled(refine_bodies, code_folder(Path(__file__)))
