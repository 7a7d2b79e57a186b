"""Bodies' motions and all their points refined together by reprojection errors.

A body turns and moves with one twist (ω, v) over the span: ω and v are along the world's axes, v is
the velocity of the body's point at `origin` now. A point X of now was at an earlier time, s seconds
ago, at M(s) X with M(s) = exp(-s (ω, v)) about the origin. Points are eliminated from the normal
equations (Schur complement; B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1), all bodies of a
frame in one batch.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.refinement_kernel import Sightings, reduce_points_compiled
from ovmot.settings import ObjectSettings
from ovmot.types import PixelNoise

_ITERATIONS = 6
_WIDE_ITERATIONS = 2  # at first, that leave out only what is far off
_SMALL_STEP = 0.02  # squared sigmas: of a step after which the next one is nothing
_HUBER_SHARE = 0.1  # of good points that lie beyond the quadratic part of the loss
_OUTLIER_SHARE = 0.001  # of good points that count as wrong
_PRIOR_DOF = 20.0  # degrees of freedom that the noise told counts for
_MIN_INVERSE_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class BodyViews:
    """B bodies with M points in V views, the last one now.

    `seen` (V, M, 4): plane coordinates, NaN where unseen; all are seen now. `body` (M,): whose
    point. `T_world_cam0` (V, B, 4, 4), `span_s` (V, B): pose and age of each body's views.
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
        """From world axes about the origin into each view (V, B, 4, 4), and out of the present one
        (B, 4, 4)."""
        T = self.T_world_cam0.copy()
        T[..., :3, 3] -= self.origin
        return se3.inverse(T), T[-1]


@dataclass(frozen=True, slots=True)
class RefinedBodies:
    """`twist` (B, 6) as (ω, v), `covariance` (B, 6, 6), points `p_world` (M, 3), `inlier` (M,).

    `point_cov` (M, 3, 3): of the points for given twists; `by_twist` (M, 3, 6): how they follow it.
    `misfit` (B,), up to 1: the variance of the noise as the points show it, as a share of what was
    settings.
    """

    twist: FloatArray
    covariance: FloatArray
    p_world: FloatArray
    inlier: BoolArray
    point_cov: FloatArray
    by_twist: FloatArray
    misfit: FloatArray


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

    Each point is (x, y, 1/z) in the present left camera. Its whole cost is robust: Huber's weights
    beyond the bulk, none beyond what a good point shows. Turn rates have a prior: a weak one for
    the yaw of bodies that `may_turn` (B,), one that leaves all but the translation to the others.
    """
    n_bodies = len(views.origin)
    prior = np.zeros((n_bodies, 6))
    prior[:, :3] = settings.tilt_rate_sigma_rps**-2.0
    prior[may_turn, 2] = settings.yaw_rate_sigma_rps**-2.0
    sightings, valid = sightings_of(views, rig, noise)
    dof = 4 * valid.sum(0) - 3
    huber = np.sqrt(chdtri(dof, _HUBER_SHARE))
    bound = chdtri(dof, _OUTLIER_SHARE)
    point = np.column_stack([p_cam0[:, :2], np.ones(len(p_cam0))]) / p_cam0[:, 2:]
    held = np.eye(6) * (prior[:, None] + 1e-6)
    for iteration in range(_ITERATIONS):
        # Points far off now may only wait for a better motion: none is left out at first.
        wide = iteration < _WIDE_ITERATIONS
        reduced = reduce_points_compiled(
            point, twist, sightings, huber, 9.0 * bound if wide else bound
        )
        information = reduced.information + held
        gradient = reduced.gradient - prior * twist
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        follow = reduced.shift - np.einsum("mi,mij->mj", step[views.body], reduced.K)
        # No point goes behind the camera, nor more than doubles its inverse depth.
        follow[:, 2] = np.clip(follow[:, 2], -0.5 * point[:, 2], point[:, 2])
        point = point + follow
        point[:, 2] = np.maximum(point[:, 2], _MIN_INVERSE_DEPTH)
        twist = twist + step
        squared_step = (step * gradient).sum(1)  # δᵀ N δ with N δ = g
        if not wide and squared_step.max() < _SMALL_STEP:
            break
    # Misfit beyond the noise told widens the covariance; less misfit is only reported.
    kept = np.where(reduced.inlier, 1.0, 0.0)
    total = np.bincount(views.body, reduced.weight * reduced.left, n_bodies)
    free = np.bincount(views.body, kept * dof, n_bodies)
    widen = np.maximum(1.0, total / np.maximum(free, 1.0))[:, None, None]
    misfit = np.minimum(1.0, (total + _PRIOR_DOF) / (free + _PRIOR_DOF))
    to_world, p_world = _world_points(point, views)
    return RefinedBodies(
        twist=twist,
        covariance=np.asarray(np.linalg.inv(information) * widen, np.float64),
        p_world=p_world,
        inlier=reduced.inlier,
        point_cov=to_world @ reduced.N_inverse @ np.swapaxes(to_world, -1, -2),
        by_twist=to_world @ -np.swapaxes(reduced.K, -1, -2),
        misfit=misfit,
    )


def sightings_of(
    views: BodyViews, rig: StereoRig, noise: PixelNoise
) -> tuple[Sightings, BoolArray]:
    """The views with their noise, as the kernel takes them, and which of them (V, M) exist.

    A patch that is followed slides on the thing, and the right match follows the slid left one. So
    each pixel has its own noise σ, and both views share a slide c of the earlier times. Sum and
    difference of the views are independent, with variances σ² + 2 c and σ².
    """
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    focal = np.array([f0[0], f0[1], f1[0], f1[1]])
    valid = np.asarray(np.isfinite(views.seen).all(-1), np.bool_)
    flow = np.linalg.norm((views.seen - views.seen[-1])[..., :2] * focal[:2], axis=-1)
    drift = views.track_length[:, views.body] * noise.drift_per_frame_px**2
    drift = drift + (noise.drift_per_flow * np.nan_to_num(flow)) ** 2
    half = np.sqrt(0.5)
    into_view, out_of_now = views.about_origin
    sightings = Sightings(
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
    return sightings, valid


def _world_points(point: FloatArray, views: BodyViews) -> tuple[FloatArray, FloatArray]:
    """Derivative (M, 3, 3) of world points by (x, y, 1/z) of the present camera, and the points."""
    T = views.T_world_cam0[-1][views.body]
    z = 1.0 / point[:, 2]
    ray = np.column_stack([point[:, :2], np.ones(len(point))])
    J = np.zeros((len(point), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = z
    J[:, :, 2] = -ray * z[:, None] ** 2
    return T[:, :3, :3] @ J, se3.apply(T, ray * z[:, None])
