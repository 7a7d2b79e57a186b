"""From a frame's moving points to measurements of moving rigid bodies; keeps nothing."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.objects.clustering import (
    MotionHistory,
    group_points,
    main_owner,
    may_be_one,
    motion_history,
)
from ovmot.objects.refinement import BodyViews, RefinedBodies, refine_bodies
from ovmot.objects.rigid_motion import RigidGroup, best_row, extract_motions
from ovmot.objects.static_motion import STATIC_TESTS, FoundMotion, known_part
from ovmot.segmentation.stereo_history import StereoHistory
from ovmot.settings import ObjectSettings
from ovmot.types import PoseWindow, ScenePoints

_LEAK = 0.3  # of a wrong motion along the ray, across it: rays of a body differ in direction
_STEEPEST = 0.1  # slope of a road
_YAW_KNOWN = 0.5  # of the prior's standard deviation: where the points have told something
_DEPTH_SIGNAL = 3.0  # variance of depths by that of noise, from which turns are told
_FEW = 4  # points that may be a part of a body, though their group is another
_REACH_SIGMAS = 2.0  # beyond the radius, between parts of one body
_SPEED_SPREAD = 0.5  # m/s by which parts of one turning body may differ
_SPREAD_SHARE = 0.05  # and as a share of the speed
_SAME_GATE = 7.81  # 95 % of chi-squared with 3 degrees of freedom


@dataclass(frozen=True, slots=True)
class ObjectMeasurement:
    """One group of points that moves as one rigid body between an earlier frame and now.

    All in world, SI. `feature_id` (N,) of the inliers, `p_world` (N, 3) their refined positions
    now. `position` (3,): centre of their box now; `velocity` (3,) of the body there. `yaw_rate`
    about world z in rad/s, NaN where the points are too few or too close together to tell, with
    its variance. `T_now_before` (4, 4): motion in world over `span_s`, p_now = T p_before.
    `covariance` (6, 6) of position and velocity, with the ego poses' part at both times; it knows
    how well the seen points are known, not how they lie on the body. `excess` (6, 6): the part of
    it that is noise which was told, but does not show in the misfit. `size` (3,): length, width,
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
    excess: FloatArray
    yaw_rate_variance: float
    size: FloatArray


@dataclass(frozen=True, slots=True)
class _Body:
    """A measurement, the group it comes from, and the track that has most of its points, or -1."""

    group: int
    owner: int
    measured: ObjectMeasurement


def measure_objects(
    history: StereoHistory,
    points: ScenePoints,
    window: PoseWindow,
    rig: StereoRig,
    settings: ObjectSettings,
    max_range_m: float,
    rng: np.random.Generator,
) -> tuple[ObjectMeasurement, ...]:
    """The moving bodies of the newest frame, those with most points first.

    `history` is that of the frame's segmented `points`, `window` holds the updated poses. Points
    beyond `max_range_m` belong to no body.
    """
    # 1 what each point did over the last frames
    moving = motion_history(history, points, window, rig, settings, max_range_m)
    if moving is None:
        return ()
    # 2 neighbours that move alike
    groups = group_points(moving, settings)
    # 3 rigid motions in each group
    motions = [extract_motions(moving, group, rig, settings, rng) for group in groups]
    found = [motion for of_group in motions for motion in of_group]
    group_of = np.repeat(np.arange(len(groups)), [len(of_group) for of_group in motions])
    if not found:
        return ()
    # 4 motions and points together, by reprojection
    views, twist, row = _views_of(moving, found, window, rig, settings)
    index = np.concatenate([group.index for group in found])
    may_turn = _shows_turns(moving, index, views.body)
    refined = refine_bodies(
        views, twist, moving.p_cam0[index], may_turn, rig, settings, history.noise
    )
    # 5 what is left of each: enough points, moving, and not a part of another
    members = [np.flatnonzero((views.body == k) & refined.inlier) for k in range(len(found))]
    enough = [k for k, own in enumerate(members) if len(own) >= settings.min_points]
    measured = _with_ego_covariance(
        _measurements(
            enough, members, moving.feature_id[index], views, refined, may_turn, settings
        ),
        window,
        _clones_of(history, window)[row[enough]],
    )
    T_cam0_world = se3.inverse(views.T_world_cam0[-1, 0])
    is_static = STATIC_TESTS[settings.static_test]
    bodies: list[_Body] = []
    for k, body in zip(enough, measured, strict=True):
        if not _is_fast(body, settings) or _is_aloft(body, views.T_world_cam0[-1, 0], settings):
            continue
        if not is_static(_as_found(body, T_cam0_world), rig, settings):
            owner = main_owner(moving.owner[index[members[k]]])
            bodies.append(_Body(int(group_of[k]), owner, body))
    return _without_parts(bodies, settings)


def _is_fast(body: ObjectMeasurement, settings: ObjectSettings) -> bool:
    """Is what is known of a body's velocity fast enough to be a measurement?

    And more than the rest would leave in it, were the points to slide along their rays.
    """
    v = body.velocity
    known, _ = known_part(v, body.covariance[3:, 3:], settings.max_speed_sigma_mps)
    squared = float(known @ known)
    rest = max(float(v @ v) - squared, 0.0)
    return squared > max(settings.min_speed_mps**2, _LEAK**2 * rest)


def _is_aloft(body: ObjectMeasurement, T_world_cam0: FloatArray, settings: ObjectSettings) -> bool:
    """Is a body higher than road users are?

    Windows that are all matched to their neighbours stand at ρ times their distance, and seem to go
    at ρ - 1 times the rig's speed, towards it: a rigid motion, that only the height betrays.
    """
    off = np.median(body.p_world, axis=0) - T_world_cam0[:3, 3]
    slope_m = _STEEPEST * float(np.hypot(off[0], off[1]))
    return bool(off[2] > settings.max_height_m + slope_m)


def _shows_turns(history: MotionHistory, index: IntArray, body: IntArray) -> BoolArray:
    """For which of B bodies do the depths of its points differ by more than stereo scatters them?

    `index`, `body` (M,): points and whose they are. A turn shows as points at different depths move
    apart in the image. Where that difference is but noise, a turn can be made to fit anything.
    """
    n = np.bincount(body)
    z = history.p_cam0[index, 2]
    off = z - (np.bincount(body, z) / n)[body]
    scatter = np.bincount(body, off**2) / (n - 1)
    noise = np.bincount(body, history.cov_cam0[index, 2, 2]) / n
    return np.asarray(scatter > _DEPTH_SIGNAL * noise)


def _views_of(
    history: MotionHistory,
    found: list[RigidGroup],
    window: PoseWindow,
    rig: StereoRig,
    settings: ObjectSettings,
) -> tuple[BodyViews, FloatArray, IntArray]:
    """Each body's points in three views: its earlier row, one half way if there is one, now.

    And the twists (B, 6) that the rigid motions amount to.
    """
    past = history.history
    index = np.concatenate([group.index for group in found])
    body = np.repeat(np.arange(len(found)), [len(group.index) for group in found])
    accel = settings.accel_sigma_mps2
    row = np.array([best_row(history, group.index, accel) for group in found])
    between = np.array([_row_between(past.span_s, k) for k in row.tolist()])
    rows = np.stack([row, between])
    T_world_cam0 = window.T_world_imu @ rig.T_imu_cam0
    T_now = T_world_cam0[-1]
    now = np.broadcast_to(T_now, (1, len(found), 4, 4))
    earlier = past.then[rows[:, body], index]
    earlier[1, (between == row)[body]] = np.nan  # no third view
    none = np.zeros((1, len(found)))
    centre = np.stack([history.p_cam0[group.index].mean(0) for group in found])
    views = BodyViews(
        seen=np.concatenate([earlier, past.now[None, index]]),
        body=body,
        T_world_cam0=np.concatenate([T_world_cam0[_clones_of(past, window)[rows]], now]),
        span_s=np.concatenate([past.span_s[rows], none]),
        track_length=np.concatenate([past.n_frames[rows].astype(np.float64), none]),
        origin=se3.apply(T_now, centre),
    )
    T_now_then = np.stack([group.T_now_then for group in found])
    shift = se3.make(np.eye(3), views.origin)
    T_world = se3.inverse(shift) @ T_now @ T_now_then @ se3.inverse(T_now) @ shift
    span = past.span_s[[group.row for group in found]]
    return views, se3.log(T_world) / span[:, None], row


def _clones_of(history: StereoHistory, window: PoseWindow) -> IntArray:
    """Indices (L,) in the window of the clones that hold a history's earlier poses."""
    return np.asarray(np.searchsorted(window.timestamp_ns, history.clone_ns))


def _row_between(span_s: FloatArray, row: int) -> int:
    """The row nearest to half the span of `row`, among the younger ones; `row` if none is."""
    younger = np.flatnonzero(span_s < span_s[row])
    if len(younger) == 0:
        return row
    return int(younger[np.argmin(np.abs(span_s[younger] - 0.5 * span_s[row]))])


def _measurements(
    chosen: list[int],
    members: list[IntArray],
    feature_id: IntArray,
    views: BodyViews,
    refined: RefinedBodies,
    may_turn: BoolArray,
    settings: ObjectSettings,
) -> list[ObjectMeasurement]:
    """The chosen bodies with their points: the covariances are those of the refinement alone."""
    span = views.span_s[0]
    shift = se3.make(np.eye(3), views.origin)
    T_now_before = shift @ se3.exp(span[:, None] * refined.twist) @ se3.inverse(shift)
    accel = (0.5 * settings.accel_sigma_mps2 * span) ** 2
    prior = settings.yaw_rate_sigma_rps**2
    out = []
    for k in chosen:
        own, omega, v_origin = members[k], refined.twist[k, :3], refined.twist[k, 3:]
        p = refined.p_world[own]
        position, size = _box(p, v_origin)
        # position follows the twist as its points do on the mean, velocity by v + ω x arm
        J = np.zeros((6, 6))
        J[:3] = refined.by_twist[own].mean(0)
        J[3:, :3], J[3:, 3:] = -so3.hat(position - views.origin[k]), np.eye(3)
        covariance = J @ refined.covariance[k] @ J.T
        covariance[:3, :3] += refined.point_cov[own].sum(0) / len(own) ** 2
        excess = (1.0 - refined.misfit[k]) * covariance
        covariance[3:, 3:] += accel[k] * np.eye(3)
        variance = float(refined.covariance[k, 2, 2]) if may_turn[k] else prior
        known = variance < _YAW_KNOWN**2 * prior
        out.append(
            ObjectMeasurement(
                feature_id=feature_id[own],
                p_world=p,
                position=position,
                velocity=v_origin + J[3:, :3] @ omega,
                yaw_rate=float(omega[2]) if known else float("nan"),
                T_now_before=T_now_before[k],
                span_s=float(span[k]),
                covariance=covariance,
                excess=excess,
                yaw_rate_variance=variance,
                size=size,
            )
        )
    return out


def _box(p_world: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) in world and size (3,) of the box of points (N, 3), along the velocity."""
    speed = np.hypot(velocity[0], velocity[1])
    c, s = velocity[:2] / speed if speed > 1e-9 else (1.0, 0.0)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    local = p_world @ R
    low, high = local.min(0), local.max(0)
    return R @ (0.5 * (low + high)), high - low


def _with_ego_covariance(
    bodies: list[ObjectMeasurement], window: PoseWindow, then: IntArray
) -> list[ObjectMeasurement]:
    """The measurements with the uncertainty of the poses now and at clones `then` (B,) added.

    Points are known in the cameras' frames: δp = -R [p_imu]x δθ + δt moves where the body is at
    each time, and v = (p_now - p_then) / span. Right perturbations of the poses.
    """
    if not bodies:
        return []
    p_now = np.array([body.position for body in bodies])
    p_then = se3.apply(se3.inverse(np.array([body.T_now_before for body in bodies])), p_now)
    span = np.array([body.span_s for body in bodies])[:, None, None]
    last = np.full_like(then, len(window.timestamp_ns) - 1)
    clone = np.stack([last, then])
    R, t = window.T_world_imu[clone, :3, :3], window.T_world_imu[clone, :3, 3]
    p_imu = (np.swapaxes(R, -1, -2) @ (np.stack([p_now, p_then]) - t)[..., None])[..., 0]
    J = np.zeros((len(bodies), 7, 12))  # position, velocity, yaw rate by both poses
    J[:, :3, :3], J[:, :3, 3:6] = -R[0] @ so3.hat(p_imu[0]), np.eye(3)
    J[:, 3:6, :6] = J[:, :3, :6] / span
    J[:, 3:6, 6:9], J[:, 3:6, 9:] = R[1] @ so3.hat(p_imu[1]) / span, -np.eye(3) / span
    J[:, 6, :3], J[:, 6, 6:9] = R[0, :, 2] / span[..., 0], -R[1, :, 2] / span[..., 0]
    pick = (6 * clone.T[..., None] + np.arange(6)).reshape(-1, 12)
    P = window.covariance[pick[:, :, None], pick[:, None, :]]
    added = J @ P @ np.swapaxes(J, -1, -2)
    return [
        replace(
            body,
            covariance=body.covariance + C[:6, :6],
            yaw_rate_variance=body.yaw_rate_variance + float(C[6, 6]),
        )
        for body, C in zip(bodies, added, strict=True)
    ]


def _as_found(body: ObjectMeasurement, T_cam0_world: FloatArray) -> FoundMotion:
    """The body's points now and, had they stayed where they were, in the present left camera."""
    before = se3.apply(se3.inverse(body.T_now_before), body.p_world)
    return FoundMotion(
        velocity=body.velocity,
        covariance=body.covariance[3:, 3:],
        moved=se3.apply(T_cam0_world, body.p_world),
        at_rest=se3.apply(T_cam0_world, before),
    )


def _without_parts(bodies: list[_Body], settings: ObjectSettings) -> tuple[ObjectMeasurement, ...]:
    """Those bodies that are no part of a larger one.

    Parts lie at the larger body and move like it, are not another track's, and come from the same
    group or have few points.
    """
    kept: list[_Body] = []
    for body in sorted(bodies, key=lambda b: len(b.measured.feature_id), reverse=True):
        few = len(body.measured.feature_id) <= _FEW
        if not any(
            (few or body.group == larger.group)
            and may_be_one(body.owner, larger.owner)
            and _is_part(body.measured, larger.measured, settings)
            for larger in kept
        ):
            kept.append(body)
    return tuple(body.measured for body in kept)


def _is_part(body: ObjectMeasurement, larger: ObjectMeasurement, settings: ObjectSettings) -> bool:
    apart = np.linalg.norm(body.p_world[:, None] - larger.p_world[None], axis=-1).min()
    C = body.covariance + larger.covariance
    reach = settings.neighbour_radius_m + _REACH_SIGMAS * np.sqrt(np.linalg.eigvalsh(C[:3, :3])[-1])
    dv = body.velocity - larger.velocity
    spread = _SPEED_SPREAD + _SPREAD_SHARE * float(np.linalg.norm(larger.velocity))
    C_v = C[3:, 3:] + spread**2 * np.eye(3)
    return bool(apart < reach and dv @ np.linalg.solve(C_v, dv) < _SAME_GATE)
