"""Bundle adjustment of bodies: their twists and all their points, by reprojection errors.

A body has one twist (ω, v) over the span: ω and v are along the world's axes, v is the velocity of
the body's point at `origin` now. A present point X was at M(s) X s seconds ago, with M(s) =
exp(-s (ω, v)) about the origin. Points are eliminated from the normal equations (Schur complement;
B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1), all bodies of a frame in one batch.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.bodies_kernel import view_weights_compiled, world_points_compiled
from ovmot.objects.refinement_kernel import Refined, WeightedViews, refine_compiled
from ovmot.physics import gate
from ovmot.settings import ObjectSettings
from ovmot.types import PixelNoise

_PRIOR_DOF = 20.0  # weight of the prior noise in the variance factor, degrees of freedom


@dataclass(frozen=True, slots=True)
class BodyViews:
    """B bodies with M points in V views, the last one now.

    `seen` (V, M, 4): normalized coordinates, NaN where unseen; all are seen now. `body` (M,): of
    each point. `T_world_cam0` (V, B, 4, 4), `span_s` (V, B): pose and age of each body's views.
    `track_length` (V, B): frames over which a point was tracked. `origin` (B, 3) in world.
    """

    seen: FloatArray
    body: IntArray
    T_world_cam0: FloatArray
    span_s: FloatArray
    track_length: FloatArray
    origin: FloatArray

    @property
    def about_origin(self) -> tuple[FloatArray, FloatArray]:
        """Transforms (V, B, 4, 4) from world axes about the origin into each view, and (B, 4, 4)
        out of the present one."""
        T = self.T_world_cam0.copy()
        T[..., :3, 3] -= self.origin
        return se3.inverse(T), T[-1]


@dataclass(frozen=True, slots=True)
class RefinedBodies:
    """`twist` (B, 6) as (ω, v), `covariance` (B, 6, 6), points `p_world` (M, 3), `inlier` (M,).

    `point_cov` (M, 3, 3): of the points for given twists; `by_twist` (M, 3, 6): their derivative by
    it. `variance_factor` (B,), at most 1: the variance of the pixel noise by the residuals, as a
    share of the prior one.
    """

    twist: FloatArray
    covariance: FloatArray
    p_world: FloatArray
    inlier: BoolArray
    point_cov: FloatArray
    by_twist: FloatArray
    variance_factor: FloatArray


def refine_bodies(
    views: BodyViews,
    twist: FloatArray,
    p_cam0: FloatArray,
    may_turn: BoolArray,
    rig: StereoRig,
    settings: ObjectSettings,
    noise: PixelNoise,
) -> RefinedBodies:
    """Levenberg-damped Gauss-Newton from `twist` (B, 6) and stereo points `p_cam0` (M, 3) of now.

    Each point is (x, y, 1/z) in the present left camera. The loss is robust in the cost of a whole
    point: Huber's weight, and zero for outliers. Turn rates have a prior of mean zero: a weak one
    for the yaw of bodies that `may_turn` (B,), else one that all but fixes them.
    """
    n_bodies = len(views.origin)
    prior = np.zeros((n_bodies, 6))
    prior[:, :3] = settings.tilt_rate_sigma_rps**-2.0
    prior[may_turn, 2] = settings.yaw_rate_sigma_rps**-2.0
    weighted, valid = weighted_views(views, rig, noise)
    n_views = valid.sum(0)
    huber, bound = np.sqrt(_cost_gates(len(valid), 0.9)), _cost_gates(len(valid), 0.999)
    point = np.column_stack([p_cam0[:, :2], np.ones(len(p_cam0))]) / p_cam0[:, 2:]
    found = refine_compiled(point, twist, weighted, huber[n_views], bound[n_views], prior)
    widen, variance_factor = _variance_factors(found, views.body, 4 * n_views - 3, n_bodies)
    p_world, point_cov, by_twist = world_points_compiled(
        found.point, np.ascontiguousarray(views.T_world_cam0[-1]), views.body, found.N_inverse,
        found.K,
    )  # fmt: skip
    return RefinedBodies(
        twist=found.twist,
        covariance=np.asarray(np.linalg.inv(found.information) * widen[:, None, None], np.float64),
        p_world=p_world,
        inlier=found.inlier,
        point_cov=point_cov,
        by_twist=by_twist,
        variance_factor=variance_factor,
    )


def _cost_gates(n_views: int, probability: float) -> FloatArray:
    """Bounds (V + 1,) of the cost of a point that is seen in 0 to V stereo pairs."""
    return np.array([gate(max(4 * v - 3, 1), probability) for v in range(n_views + 1)])


def _variance_factors(
    found: Refined, body: IntArray, dof: IntArray, n_bodies: int
) -> tuple[FloatArray, FloatArray]:
    """Variance of the noise by the residuals as a share of the prior one: (B,) at least 1, and (B,)
    at most 1, which holds the prior noise as well.

    `dof` (M,): degrees of freedom of each point. Noise above the prior one widens the covariance;
    noise below it is only reported.
    """
    cost = np.bincount(body, found.weight * found.cost, n_bodies)
    body_dof = np.bincount(body, np.where(found.inlier, dof, 0.0), n_bodies)
    widen = np.maximum(1.0, cost / np.maximum(body_dof, 1.0))
    return widen, np.minimum(1.0, (cost + _PRIOR_DOF) / (body_dof + _PRIOR_DOF))


def weighted_views(
    views: BodyViews, rig: StereoRig, noise: PixelNoise
) -> tuple[WeightedViews, BoolArray]:
    """The views with their weights, as the kernel takes them, and which of them (V, M) exist.

    A tracked patch drifts on the surface, and the right match is that of the drifted left one. So
    each pixel has its own noise of variance σ², and both cameras share a drift of variance c since
    the earlier times. Sum and difference of the cameras are independent, with variances σ² + 2 c
    and σ².
    """
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    focal = np.array([f0[0], f0[1], f1[0], f1[1]])
    seen = np.ascontiguousarray(views.seen)
    by_difference, by_sum, valid = view_weights_compiled(
        seen, views.body, views.track_length, focal, noise.sigma_px, noise.drift_per_frame_px,
        noise.drift_per_flow,
    )  # fmt: skip
    into_view, out_of_now = views.about_origin
    weighted = WeightedViews(
        seen=seen,
        by_difference=by_difference,
        by_sum=by_sum,
        body=views.body,
        span_s=np.ascontiguousarray(views.span_s),
        into_view=into_view,
        out_of_now=np.ascontiguousarray(out_of_now),
        T_cam1_cam0=np.ascontiguousarray(rig.T_cam1_cam0),
        focal=focal,
    )
    return weighted, valid
