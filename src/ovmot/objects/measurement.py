"""Measurements of moving rigid bodies, from the moving points of one frame; without state."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.bodies_kernel import (
    Grouped,
    RoadUser,
    can_be_bodies_compiled,
    without_parts_compiled,
)
from ovmot.objects.body_views_kernel import BodyViews, MovingViews, body_views_compiled
from ovmot.objects.clustering import (
    MAX_POINTS,
    ONE_BODY,
    MotionHistory,
    group_points,
    motion_history,
)
from ovmot.objects.measurement_kernel import (
    BodyPoints,
    BodyTwists,
    MeasuredBodies,
    measure_bodies_compiled,
)
from ovmot.objects.refined_bodies_kernel import RefinedBodies
from ovmot.objects.refinement import refine_bodies
from ovmot.objects.rigid_kernel import Motions
from ovmot.objects.rigid_motion import extract_motions
from ovmot.objects.static_motion import MAX_SIGMA_MPS, STATIC_TESTS, FoundMotions
from ovmot.physics import (
    CAR_SIZE_M,
    LEAST_HEIGHT_M,
    MAX_SLOPE,
    MAX_VEHICLE_SIZE_M,
    gates,
)
from ovmot.settings import ObjectSettings, SegmentationSettings
from ovmot.types import PointLabel, PoseWindow, ScenePoints


@dataclass(frozen=True, slots=True)
class ObjectMeasurement:
    """One group of points that moves as one rigid body between an earlier frame and now.

    All in world, SI. `feature_id` (N,) of the inliers, `p_world` (N, 3) their refined positions
    now. `position` (3,): centre of their box now; `velocity` (3,) of the body there.
    `T_now_before` (4, 4): motion in world over `span_s`, p_now = T p_before. `covariance` (6, 6) of
    position and velocity by the pixel noise, with the ego poses' part at both times; it is that of
    the seen points, not of where they lie on the body. `size` (3,): length, width, height of the
    box of the points, along the heading.
    """

    feature_id: IntArray
    p_world: FloatArray
    position: FloatArray
    velocity: FloatArray
    T_now_before: FloatArray
    span_s: float
    covariance: FloatArray
    size: FloatArray


def measure_objects(
    history: StereoHistory,
    points: ScenePoints,
    window: PoseWindow,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
    rng: np.random.Generator,
) -> tuple[ObjectMeasurement, ...]:
    """The moving bodies of the newest frame, those with most points first.

    `history` is that of the frame's segmented `points`, `window` holds the updated poses. Points
    beyond the range of the segmentation, `of_points`, belong to no body.
    """
    # 1 the motion of each point over the last frames
    moving = motion_history(history, points, window, rig, settings, of_points.max_range_m)
    if moving is None:
        return ()
    # 2 clusters of neighbours with one velocity
    clustered, size = group_points(moving, settings)
    # 3 rigid motions in each cluster
    found = extract_motions(moving, clustered, size, rig, settings, rng)
    if len(found.size) == 0:
        return ()
    # 4 bundle adjustment of motions and points
    clone = window.timestamp_ns.searchsorted(history.clone_ns)
    views, may_turn = _views_of(moving, found, window, clone, rig)
    refined = refine_bodies(views, may_turn, rig, settings, history.noise)
    # 5 bodies with enough inliers, with their covariances
    measured = _measured(views, refined, window, clone[found.velocity_row], settings)
    # 6 those that move and are no part of another
    T_world_cam0 = views.T_world_cam0[-1, 0]
    moves = _can_be_bodies(measured, refined.p_world, points, T_world_cam0, settings)
    if not moves.any():
        return ()
    motions = FoundMotions(measured, refined.p_world, T_world_cam0)
    moves &= ~STATIC_TESTS[settings.static_test](motions, rig, settings, of_points)
    kept = without_parts_compiled(
        measured, refined.p_world, moves, Grouped(found.point, moving.track_id, found.group),
        ONE_BODY,
    )  # fmt: skip
    feature_id = moving.feature_id[found.point]
    return tuple(_measurement(k, feature_id, views, refined, measured) for k in kept.tolist())


def _can_be_bodies(
    measured: MeasuredBodies,
    p_world: FloatArray,
    points: ScenePoints,
    T_world_cam0: FloatArray,
    settings: ObjectSettings,
) -> BoolArray:
    """Which bodies (B,) with points `p_world` (M, 3) can be road users, as a frame's points tell.

    Those with enough points, fast enough, not aloft, and not flat on the ground: patches of a road
    seen at a grazing angle drift together, and no road user is as low as `LEAST_HEIGHT_M`.
    """
    user = RoadUser(
        settings.min_points, settings.min_speed_mps, MAX_SIGMA_MPS, MAX_VEHICLE_SIZE_M[2],
        MAX_SLOPE, LEAST_HEIGHT_M, CAR_SIZE_M[0],
    )  # fmt: skip
    is_static = points.label == int(PointLabel.STATIC)
    return can_be_bodies_compiled(measured, p_world, points.p_cam0, is_static, T_world_cam0, user)


def _views_of(
    points: MotionHistory, found: Motions, window: PoseWindow, clone: IntArray, rig: StereoRig
) -> tuple[BodyViews, BoolArray]:
    """The views of the bodies, and of which of them the turn rate is observable (B,).

    `clone` (L,): the window's poses at the earlier rows.
    """
    past = points.history
    moving = MovingViews(
        past.then, past.now, past.span_s, past.n_frames, points.index, points.p_cam0,
        points.cov_cam0, np.ascontiguousarray(window.T_world_imu), clone,
        np.ascontiguousarray(rig.T_imu_cam0),
    )  # fmt: skip
    return body_views_compiled(moving, found, gates(MAX_POINTS, 0.99))


def _measured(
    views: BodyViews,
    refined: RefinedBodies,
    window: PoseWindow,
    clone: IntArray,
    settings: ObjectSettings,
) -> MeasuredBodies:
    """The B bodies' measurements; `clone` (B,): their earlier poses in the window."""
    return measure_bodies_compiled(
        BodyPoints(
            refined.p_world, refined.by_twist, refined.point_cov, views.body, refined.inlier
        ),
        BodyTwists(
            refined.twist, refined.covariance, views.origin, views.span_s[0], clone
        ),
        np.ascontiguousarray(window.T_world_imu), np.ascontiguousarray(window.covariance),
        settings.accel_sigma_mps2, settings.min_points,
    )  # fmt: skip


def _measurement(
    k: int,
    feature_id: IntArray,
    views: BodyViews,
    refined: RefinedBodies,
    measured: MeasuredBodies,
) -> ObjectMeasurement:
    """Body k; `feature_id` (M,): of the points of all bodies."""
    own = measured.members[measured.first[k] : measured.first[k] + measured.n_members[k]]
    return ObjectMeasurement(
        feature_id=feature_id[own],
        p_world=refined.p_world[own],
        position=measured.position[k],
        velocity=measured.velocity[k],
        T_now_before=measured.T_now_before[k],
        span_s=float(views.span_s[0, k]),
        covariance=measured.covariance[k],
        size=measured.size[k],
    )
