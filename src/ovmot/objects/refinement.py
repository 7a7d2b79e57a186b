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
from ovmot.config import ObjectSettings
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import inverse_3x3, project_plane

_ITERATIONS = 6
_WIDE_ITERATIONS = 2  # at first, that leave out only what is far off
_SMALL_STEP = 0.02  # squared sigmas: of a step after which the next one is nothing
_HUBER_SHARE = 0.1  # of good points that lie beyond the quadratic part of the loss
_OUTLIER_SHARE = 0.001  # of good points that count as wrong
_MIN_INVERSE_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class BodyViews:
    """B bodies with M points in V views, the last one now.

    `seen` (V, M, 4): plane coordinates, NaN where unseen; all are seen now. `body` (M,): whose
    point. `T_world_cam0` (V, B, 4, 4), `span_s` (V, B): pose and age of each body's views.
    `hops` (V, B): frames through which a point was followed since. `origin` (B, 3) in world.
    """

    seen: FloatArray
    body: IntArray
    T_world_cam0: FloatArray
    span_s: FloatArray
    hops: FloatArray
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
    """

    twist: FloatArray
    covariance: FloatArray
    p_world: FloatArray
    inlier: BoolArray
    point_cov: FloatArray
    by_twist: FloatArray


def refine_bodies(
    views: BodyViews,
    twist: FloatArray,
    p_cam0: FloatArray,
    may_turn: BoolArray,
    rig: StereoRig,
    told: ObjectSettings,
) -> RefinedBodies:
    """Levenberg-damped Gauss-Newton from `twist` (B, 6) and stereo points `p_cam0` (M, 3) of now.

    Each point is (x, y, 1/z) in the present left camera. Its whole cost is robust: Huber's weights
    beyond the bulk, none beyond what a good point shows. Turn rates have a prior: a weak one for
    the yaw of bodies that `may_turn` (B,), one that leaves all but the translation to the others.
    """
    n_bodies = len(views.origin)
    prior = np.zeros((n_bodies, 6))
    prior[:, :3] = told.tilt_rate_sigma_rps**-2.0
    prior[may_turn, 2] = told.yaw_rate_sigma_rps**-2.0
    weighting = Weighting(views, rig, told)
    freedom = 4 * weighting.valid.sum(0) - 3
    huber = np.sqrt(chdtri(freedom, _HUBER_SHARE))
    bound = chdtri(freedom, _OUTLIER_SHARE)
    point = np.column_stack([p_cam0[:, :2], np.ones(len(p_cam0))]) / p_cam0[:, 2:]
    for iteration in range(_ITERATIONS):
        r, A, J = weighting.residuals(point, twist)
        At = np.swapaxes(A, -1, -2)
        N_inverse, g = inverse_3x3(At @ A), At @ r
        cross = At @ J
        left = (r * r).sum((1, 2)) - (np.swapaxes(g, -1, -2) @ N_inverse @ g)[:, 0, 0]
        weight = np.minimum(1.0, huber / np.sqrt(np.maximum(left, 1e-12)))
        # Points far off now may only wait for a better motion: none is left out at first.
        inlier = left < (bound if iteration >= _WIDE_ITERATIONS else 9.0 * bound)
        weight = np.where(inlier, weight, 0.0)[:, None, None]
        K = np.swapaxes(cross, -1, -2) @ N_inverse
        Jt = np.swapaxes(J, -1, -2)
        information = _sum_per_body(weight * (Jt @ J - K @ cross), views.body, n_bodies)
        information = information + np.eye(6) * (prior[:, None] + 1e-6)
        gradient = _sum_per_body(weight * (Jt @ r - K @ g), views.body, n_bodies)[..., 0]
        step = np.linalg.solve(information, (gradient - prior * twist)[..., None])[..., 0]
        follow = (N_inverse @ (g - cross @ step[views.body][..., None]))[..., 0]
        # No point goes behind the camera, nor more than doubles its inverse depth.
        follow[:, 2] = np.clip(follow[:, 2], -0.5 * point[:, 2], point[:, 2])
        point = point + follow
        point[:, 2] = np.maximum(point[:, 2], _MIN_INVERSE_DEPTH)
        twist = twist + step
        step_size = np.einsum("bi,bij,bj->b", step, information, step)
        if iteration >= _WIDE_ITERATIONS and step_size.max() < _SMALL_STEP:
            break
    # Misfit beyond the noise told widens the covariance; less misfit does not narrow it.
    kept = np.where(inlier, 1.0, 0.0)
    total = np.bincount(views.body, kept * weight[:, 0, 0] * left, n_bodies)
    free = np.bincount(views.body, kept * freedom, n_bodies)
    widen = np.maximum(1.0, total / np.maximum(free, 1.0))[:, None, None]
    to_world, p_world = _world_points(point, views)
    return RefinedBodies(
        twist=twist,
        covariance=np.asarray(np.linalg.inv(information) * widen, np.float64),
        p_world=p_world,
        inlier=inlier,
        point_cov=to_world @ N_inverse @ np.swapaxes(to_world, -1, -2),
        by_twist=to_world @ -np.swapaxes(K, -1, -2),
    )


class Weighting:
    """Residuals in standard deviations, with derivatives: what stays the same over iterations.

    A patch that is followed slides on the thing, and the right match follows the slid left one. So
    each pixel has its own noise σ, and both views share a slide c of the earlier times. Sum and
    difference of the views are independent, with variances σ² + 2 c and σ².
    """

    def __init__(self, views: BodyViews, rig: StereoRig, told: ObjectSettings) -> None:
        self._views = views
        self._T_c1_c0 = rig.T_cam1_cam0
        f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
        self._focal = np.array([f0[0], f0[1], f1[0], f1[1]])
        self.valid = np.asarray(np.isfinite(views.seen).all(-1), np.bool_)
        flow = np.linalg.norm((views.seen - views.seen[-1])[..., :2] * self._focal[:2], axis=-1)
        slide = views.hops[:, views.body] * told.slide_per_hop_px**2
        slide = slide + (told.slide_per_flow * np.nan_to_num(flow)) ** 2
        half = np.sqrt(0.5)
        self._by_difference = np.where(self.valid, half / told.pixel_sigma, 0.0)
        self._by_sum = np.where(self.valid, half / np.sqrt(told.pixel_sigma**2 + 2.0 * slide), 0.0)
        self._seen = np.where(self.valid[..., None], views.seen, 0.0)

    def residuals(
        self, point: FloatArray, twist: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (M, 4V, 1) of points (M, 3), derivatives by point (.., 3) and twist (.., 6)."""
        views = self._views
        T, by_twist = moved_views(views, twist)
        body = views.body
        T = T[:, body]
        R, t = T[..., :3, :3], T[..., :3, 3]
        ray = np.column_stack([point[:, :2], np.ones(len(point))])
        inverse_depth = point[:, 2:]
        q = (R @ ray[..., None])[..., 0] + inverse_depth * t
        T10 = self._T_c1_c0
        h0, J0 = project_plane(q)
        h1, J1 = project_plane(q @ T10[:3, :3].T + inverse_depth * T10[:3, 3])
        by_q = np.concatenate([J0, J1 @ T10[:3, :3]], axis=-2)
        by_depth = (by_q @ t[..., None])[..., 0]
        by_depth[..., 2:] += J1 @ T10[:3, 3]
        by_point = np.concatenate([by_q @ R[..., :2], by_depth[..., None]], axis=-1)

        # d q = C [-[D]x, ρ I] τ, D: the point in world about the origin, by its inverse depth
        C, E = by_twist
        T_now = views.T_world_cam0[-1][body]
        D = (T_now[:, :3, :3] @ ray[..., None])[..., 0]
        D = D + inverse_depth * (T_now[:, :3, 3] - views.origin[body])
        arm = np.concatenate([-so3.hat(D), inverse_depth[..., None] * np.eye(3)], axis=-1)
        by_motion = (by_q @ C[:, body]) @ (arm @ E[:, body])
        r = self._seen - np.concatenate([h0, h1], axis=-1)
        rows = np.concatenate([r[..., None], by_point, by_motion], axis=-1)
        white = self._whiten(rows)
        return white[..., :1], white[..., 1:4], white[..., 4:]

    def _whiten(self, rows: FloatArray) -> FloatArray:
        """(V, M, 4, k) in plane units to (M, 4V, k) in standard deviations."""
        left, right = (
            rows[..., :2, :] * self._focal[:2, None],
            rows[..., 2:, :] * self._focal[2:, None],
        )
        n_views, n_points, _, width = left.shape
        out = np.empty((n_points, n_views, 4, width))
        by_view = np.swapaxes(out, 0, 1)
        by_view[..., :2, :] = (left - right) * self._by_difference[..., None, None]
        by_view[..., 2:, :] = (left + right) * self._by_sum[..., None, None]
        return out.reshape(n_points, 4 * n_views, width)


def moved_views(
    views: BodyViews, twist: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """T_then_now (V, B, 4, 4) from the present left camera into each view, through the body.

    And, for M(s) exp(τ) = exp(-s (ξ + δ)), the rotation C (V, B, 3, 3) of a change of the point
    into the view, and τ = E δ with E = -s J_r(-s ξ) (V, B, 6, 6).
    """
    backwards = -views.span_s[..., None] * twist
    into_view, out_of_now = views.about_origin
    into_view = into_view @ se3.exp(backwards)
    E = -views.span_s[..., None, None] * se3.right_jacobian(backwards)
    return into_view @ out_of_now, (into_view[..., :3, :3], E)


def _world_points(point: FloatArray, views: BodyViews) -> tuple[FloatArray, FloatArray]:
    """Derivative (M, 3, 3) of world points by (x, y, 1/z) of the present camera, and the points."""
    T = views.T_world_cam0[-1][views.body]
    z = 1.0 / point[:, 2]
    ray = np.column_stack([point[:, :2], np.ones(len(point))])
    J = np.zeros((len(point), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = z
    J[:, :, 2] = -ray * z[:, None] ** 2
    return T[:, :3, :3] @ J, se3.apply(T, ray * z[:, None])


def _sum_per_body(values: FloatArray, body: IntArray, n_bodies: int) -> FloatArray:
    """Sums (B, ...) of values (M, ...) over each body's points."""
    member = (body[None] == np.arange(n_bodies)[:, None]).astype(np.float64)
    total: FloatArray = (member @ values.reshape(len(values), -1)).reshape(
        n_bodies, *values.shape[1:]
    )
    return total
