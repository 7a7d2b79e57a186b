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
from ovmot.objects.refinement_kernel import Reduced, WeightedViews, reduce_points_compiled
from ovmot.physics import gates
from ovmot.settings import ObjectSettings
from ovmot.types import PixelNoise

_ITERATIONS = 6
_WIDE_ITERATIONS = 2  # the first ones, with a wider bound for outliers
_SMALL_STEP = 0.02  # squared sigmas: a step that ends the iterations
_PRIOR_DOF = 20.0  # weight of the prior noise in the variance factor, degrees of freedom
_MIN_INVERSE_DEPTH = 1e-3


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
    dof = 4 * valid.sum(0) - 3
    huber, bound = np.sqrt(gates(dof, 0.9)), gates(dof, 0.999)
    point = np.column_stack([p_cam0[:, :2], np.ones(len(p_cam0))]) / p_cam0[:, 2:]
    prior_information = np.eye(6) * (prior[:, None] + 1e-6)
    for iteration in range(_ITERATIONS):
        # A point far off now may fit a better motion: the bound is wide at first.
        wide = iteration < _WIDE_ITERATIONS
        reduced = reduce_points_compiled(
            point, twist, weighted, huber, 9.0 * bound if wide else bound
        )
        information = reduced.information + prior_information
        gradient = reduced.gradient - prior * twist
        step = np.asarray(np.linalg.solve(information, gradient[..., None])[..., 0], np.float64)
        point = _stepped_points(point, reduced, step[views.body])
        twist = twist + step
        squared_step = (step * gradient).sum(1)  # δᵀ N δ with N δ = g
        if not wide and squared_step.max() < _SMALL_STEP:
            break
    # Noise above the prior one widens the covariance; noise below it is only reported.
    inliers = np.where(reduced.inlier, 1.0, 0.0)
    cost = np.bincount(views.body, reduced.weight * reduced.cost, n_bodies)
    body_dof = np.bincount(views.body, inliers * dof, n_bodies)
    widen = np.maximum(1.0, cost / np.maximum(body_dof, 1.0))[:, None, None]
    variance_factor = np.minimum(1.0, (cost + _PRIOR_DOF) / (body_dof + _PRIOR_DOF))
    to_world, p_world = _world_points(point, views)
    return RefinedBodies(
        twist=twist,
        covariance=np.asarray(np.linalg.inv(information) * widen, np.float64),
        p_world=p_world,
        inlier=reduced.inlier,
        point_cov=to_world @ reduced.N_inverse @ np.swapaxes(to_world, -1, -2),
        by_twist=to_world @ -np.swapaxes(reduced.K, -1, -2),
        variance_factor=variance_factor,
    )


def _stepped_points(point: FloatArray, reduced: Reduced, twist_step: FloatArray) -> FloatArray:
    """Points (M, 3) after a step (M, 6) of their bodies' twists.

    No point goes behind the camera, nor more than doubles its inverse depth.
    """
    step: FloatArray = reduced.step - np.einsum("mi,mij->mj", twist_step, reduced.K)
    step[:, 2] = np.clip(step[:, 2], -0.5 * point[:, 2], point[:, 2])
    stepped: FloatArray = point + step
    stepped[:, 2] = np.maximum(stepped[:, 2], _MIN_INVERSE_DEPTH)
    return stepped


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
    valid = np.asarray(np.isfinite(views.seen).all(-1), np.bool_)
    flow = np.linalg.norm((views.seen - views.seen[-1])[..., :2] * focal[:2], axis=-1)
    drift = views.track_length[:, views.body] * noise.drift_per_frame_px**2
    drift = drift + (noise.drift_per_flow * np.nan_to_num(flow)) ** 2
    half = np.sqrt(0.5)
    into_view, out_of_now = views.about_origin
    weighted = WeightedViews(
        seen=np.ascontiguousarray(views.seen),
        by_difference=np.where(valid, half / noise.sigma_px, 0.0),
        by_sum=np.where(valid, half / np.sqrt(noise.sigma_px**2 + 2.0 * drift), 0.0),
        body=views.body,
        span_s=np.ascontiguousarray(views.span_s),
        into_view=into_view,
        out_of_now=np.ascontiguousarray(out_of_now),
        T_cam1_cam0=np.ascontiguousarray(rig.T_cam1_cam0),
        focal=focal,
    )
    return weighted, valid


def _world_points(point: FloatArray, views: BodyViews) -> tuple[FloatArray, FloatArray]:
    """Derivative (M, 3, 3) of world points by (x, y, 1/z) of the present camera, and the points."""
    T = views.T_world_cam0[-1][views.body]
    z = 1.0 / point[:, 2]
    ray = np.column_stack([point[:, :2], np.ones(len(point))])
    J = np.zeros((len(point), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = z
    J[:, :, 2] = -ray * z[:, None] ** 2
    return T[:, :3, :3] @ J, se3.apply(T, ray * z[:, None])
