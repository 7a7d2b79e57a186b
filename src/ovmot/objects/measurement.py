"""Measurements of moving rigid bodies, from the moving points of one frame; without state."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.bodies_kernel import (
    height_above_ground_compiled,
    least_distance_compiled,
    twists_about_compiled,
)
from ovmot.objects.clustering import (
    MotionHistory,
    compatible_tracks,
    group_points,
    majority_track,
    motion_history,
    same_body_velocity,
)
from ovmot.objects.clustering_kernel import NEIGHBOUR_RADIUS_M
from ovmot.objects.measurement_kernel import (
    BodyPoints,
    BodyTwists,
    MeasuredBodies,
    known_part_compiled,
    measure_bodies_compiled,
)
from ovmot.objects.refinement import BodyViews, RefinedBodies, refine_bodies
from ovmot.objects.rigid_kernel import Motions
from ovmot.objects.rigid_motion import extract_motions
from ovmot.objects.static_motion import MAX_SIGMA_MPS, STATIC_TESTS, FoundMotion
from ovmot.physics import CAR_SIZE_M, LEAST_HEIGHT_M, MAX_VEHICLE_SIZE_M, gate
from ovmot.settings import ObjectSettings, SegmentationSettings
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_LEAK = 0.3  # share of a wrong motion along the ray that shows across it: the rays of a body differ
_STEEPEST = 0.1  # slope of a road
_YAW_KNOWN = 0.5  # of the prior's standard deviation: below, the points have measured the yaw rate
_FEW = 4  # points that may be a part of a body of another group
_REACH_SIGMAS = 2.0  # beyond the radius, between parts of one body


@dataclass(frozen=True, slots=True)
class ObjectMeasurement:
    """One group of points that moves as one rigid body between an earlier frame and now.

    All in world, SI. `feature_id` (N,) of the inliers, `p_world` (N, 3) their refined positions
    now. `position` (3,): centre of their box now; `velocity` (3,) of the body there. `yaw_rate`
    about world z in rad/s, NaN where the points do not measure it, with its variance.
    `T_now_before` (4, 4): motion in world over `span_s`, p_now = T p_before. `covariance` (6, 6) of
    position and velocity by the prior pixel noise, with the ego poses' part at both times; it is
    that of the seen points, not of where they lie on the body. `scaled_covariance` (6, 6): the same
    with the points' part times the variance factor of the refinement. `size` (3,): length, width,
    height of the box of the points, along the heading.
    """

    feature_id: IntArray
    p_world: FloatArray
    position: FloatArray
    velocity: FloatArray
    yaw_rate: float
    T_now_before: FloatArray
    span_s: float
    covariance: FloatArray
    scaled_covariance: FloatArray
    yaw_rate_variance: float
    size: FloatArray


@dataclass(frozen=True, slots=True)
class _Body:
    """A measurement, its group, and the track that holds most of its points, or -1."""

    group: int
    track_id: int
    measurement: ObjectMeasurement


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
    index, row = found.point, found.velocity_row
    views, twist = _views_of(moving, found, window, rig)
    T_world_cam0 = views.T_world_cam0[-1, 0]
    may_turn = _turns_observable(moving, index, views.body)
    refined = refine_bodies(
        views, twist, moving.p_cam0[index], may_turn, rig, settings, history.noise
    )
    # 5 bodies with enough inliers, with their covariances
    clones = _clones_of(history, window)[row]
    measured = _measured(views, refined, window, clones, settings)
    # 6 those that move and are no part of another
    bodies = []
    static = _static_points(points, T_world_cam0)
    for k, own in enumerate(np.split(measured.members, np.cumsum(measured.n_members))[:-1]):
        if len(own) >= settings.min_points and not _is_aloft(measured.middle[k], T_world_cam0):
            body = _measurement(
                k, own, moving.feature_id[index], views, refined, measured, may_turn, settings
            )
            moves = _moves(body, T_world_cam0, rig, settings, of_points)
            if moves and not lies_flat(body.p_world, static):
                track_id = majority_track(moving.track_id[index[own]])
                bodies.append(_Body(int(found.group[k]), track_id, body))
    return _without_parts(bodies, settings)


def _moves(
    body: ObjectMeasurement,
    T_world_cam0: FloatArray,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> bool:
    """Is a body in motion: fast enough, and not at rest?"""
    if not _is_fast(body, settings):
        return False
    motion = FoundMotion(
        body.velocity, body.covariance[3:, 3:], body.p_world, body.T_now_before,
        se3.inverse(T_world_cam0),
    )  # fmt: skip
    return not STATIC_TESTS[settings.static_test](motion, rig, settings, of_points)


def _is_fast(body: ObjectMeasurement, settings: ObjectSettings) -> bool:
    """Is the known part of a body's velocity fast enough to be a measurement?

    And greater than what a drift of its patches along their rays, the unknown part, leaves in it.
    """
    v = body.velocity
    known, _ = known_part_compiled(v, body.covariance[3:, 3:], MAX_SIGMA_MPS)
    known_squared = float(known @ known)
    unknown_squared = max(float(v @ v) - known_squared, 0.0)
    return known_squared > max(settings.min_speed_mps**2, _LEAK**2 * unknown_squared)


def _is_aloft(middle: FloatArray, T_world_cam0: FloatArray) -> bool:
    """Is a body whose points have this median (3,) higher than road users are?

    Repeated windows that are all matched to their neighbours appear at ρ times their distance, and
    seem to move at ρ - 1 times the rig's speed, towards it: a rigid motion, but at a wrong height.
    """
    offset = middle - T_world_cam0[:3, 3]
    slope_m = _STEEPEST * float(np.hypot(offset[0], offset[1]))
    return bool(offset[2] > MAX_VEHICLE_SIZE_M[2] + slope_m)


def _static_points(points: ScenePoints, T_world_cam0: FloatArray) -> FloatArray:
    """Static points (M, 3) in the world."""
    static = (points.label == int(PointLabel.STATIC)) & np.isfinite(points.p_cam0[:, 2])
    return se3.apply(T_world_cam0, points.p_cam0[static])


def lies_flat(p_world: FloatArray, static: FloatArray, *, min_points: int = 5) -> bool:
    """Do the points (N, 3) of a body lie on the ground around it, which `static` (M, 3) show?

    Patches of a road seen at a grazing angle drift together, as a body would; no road user is as
    low as `LEAST_HEIGHT_M`. The ground is the lowest tenth of the static points within a car's
    length; with fewer than `min_points` there, nothing is known.
    """
    height = height_above_ground_compiled(
        np.ascontiguousarray(p_world), np.ascontiguousarray(static), CAR_SIZE_M[0], min_points
    )
    return height < LEAST_HEIGHT_M


def _turns_observable(history: MotionHistory, index: IntArray, body: IntArray) -> BoolArray:
    """Of which of B bodies is the turn rate observable (B,)?

    `index`, `body` (M,): points and their bodies. In a turn, points at different depths move apart
    in the image: the depths must differ by more than their noise, by a chi-squared test.
    """
    n = np.bincount(body)
    z = history.p_cam0[index, 2]
    deviation = z - (np.bincount(body, z) / n)[body]
    scatter = np.bincount(body, deviation**2)
    noise = np.bincount(body, history.cov_cam0[index, 2, 2]) / n
    bound = np.array([gate(max(int(k) - 1, 1), 0.99) for k in n])
    return np.asarray(scatter > bound * noise)


def _views_of(
    history: MotionHistory, found: Motions, window: PoseWindow, rig: StereoRig
) -> tuple[BodyViews, FloatArray]:
    """Each body's points in three views: its earlier row, one half way if there is one, now.

    Also the twists (B, 6) of the rigid motions.
    """
    past, index, row = history.history, found.point, found.velocity_row
    n_bodies = len(found.size)
    body = np.repeat(np.arange(n_bodies), found.size)
    between = np.array([_row_between(past.span_s, k) for k in row.tolist()])
    rows = np.stack([row, between])
    T_world_cam0 = window.T_world_imu @ rig.T_imu_cam0
    T_now = T_world_cam0[-1]
    now = np.broadcast_to(T_now, (1, n_bodies, 4, 4))
    earlier = past.then[rows[:, body], index]
    earlier[1, (between == row)[body]] = np.nan  # no third view
    none = np.zeros((1, n_bodies))
    first = np.cumsum(found.size) - found.size
    centre = np.add.reduceat(history.p_cam0[index], first) / found.size[:, None]
    views = BodyViews(
        seen=np.concatenate([earlier, past.now[None, index]]),
        body=body,
        T_world_cam0=np.concatenate([T_world_cam0[_clones_of(past, window)[rows]], now]),
        span_s=np.concatenate([past.span_s[rows], none]),
        track_length=np.concatenate([past.n_frames[rows].astype(np.float64), none]),
        origin=se3.apply(T_now, centre),
    )
    twist = twists_about_compiled(
        found.T_now_then, np.ascontiguousarray(T_now), views.origin, past.span_s[found.row]
    )
    return views, twist


def _clones_of(history: StereoHistory, window: PoseWindow) -> IntArray:
    """Indices (L,) in the window of the clones that hold a history's earlier poses."""
    return np.asarray(np.searchsorted(window.timestamp_ns, history.clone_ns))


def _row_between(span_s: FloatArray, row: int) -> int:
    """The row nearest to half the span of `row`, among the younger ones; `row` if none is."""
    younger = np.flatnonzero(span_s < span_s[row])
    if len(younger) == 0:
        return row
    return int(younger[np.argmin(np.abs(span_s[younger] - 0.5 * span_s[row]))])


def _measured(
    views: BodyViews,
    refined: RefinedBodies,
    window: PoseWindow,
    clones: IntArray,
    settings: ObjectSettings,
) -> MeasuredBodies:
    """The B bodies' measurements; `clones` (B,): their earlier poses in the window."""
    return measure_bodies_compiled(
        BodyPoints(
            refined.p_world, refined.by_twist, refined.point_cov, views.body, refined.inlier
        ),
        BodyTwists(
            refined.twist, refined.covariance, refined.variance_factor, views.origin,
            views.span_s[0], clones,
        ),
        np.ascontiguousarray(window.T_world_imu), np.ascontiguousarray(window.covariance),
        settings.accel_sigma_mps2, settings.min_points,
    )  # fmt: skip


def _measurement(
    k: int,
    own: IntArray,
    feature_id: IntArray,
    views: BodyViews,
    refined: RefinedBodies,
    measured: MeasuredBodies,
    may_turn: BoolArray,
    settings: ObjectSettings,
) -> ObjectMeasurement:
    """Body k with its `own` points (n,) of those with `feature_id` (M,)."""
    prior = settings.yaw_rate_sigma_rps**2
    variance = float(refined.covariance[k, 2, 2]) if may_turn[k] else prior
    known = variance < _YAW_KNOWN**2 * prior
    return ObjectMeasurement(
        feature_id=feature_id[own],
        p_world=refined.p_world[own],
        position=measured.position[k],
        velocity=measured.velocity[k],
        yaw_rate=float(refined.twist[k, 2]) if known else float("nan"),
        T_now_before=measured.T_now_before[k],
        span_s=float(views.span_s[0, k]),
        covariance=measured.covariance[k],
        scaled_covariance=measured.scaled_covariance[k],
        yaw_rate_variance=variance + float(measured.yaw_rate_variance[k]),
        size=measured.size[k],
    )


def _without_parts(bodies: list[_Body], settings: ObjectSettings) -> tuple[ObjectMeasurement, ...]:
    """Those bodies that are no part of a larger one.

    A part lies at the larger body and has its velocity, is not another track's, and comes from the
    same group or has few points.
    """
    kept: list[_Body] = []
    for body in sorted(bodies, key=lambda b: len(b.measurement.feature_id), reverse=True):
        few = len(body.measurement.feature_id) <= _FEW
        if not any(
            (few or body.group == larger.group)
            and compatible_tracks(body.track_id, larger.track_id)
            and _is_part(body.measurement, larger.measurement, settings)
            for larger in kept
        ):
            kept.append(body)
    return tuple(body.measurement for body in kept)


def _is_part(body: ObjectMeasurement, larger: ObjectMeasurement, settings: ObjectSettings) -> bool:
    C = body.covariance + larger.covariance
    if not same_body_velocity(body.velocity, larger.velocity, C[3:, 3:], 0.95):
        return False
    distance = least_distance_compiled(body.p_world, larger.p_world)
    reach = NEIGHBOUR_RADIUS_M + _REACH_SIGMAS * np.sqrt(np.linalg.eigvalsh(C[:3, :3])[-1])
    return bool(distance < reach)
