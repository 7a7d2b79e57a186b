"""Clusters of neighbouring points with one velocity: the candidates for rigid bodies."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.clustering_kernel import components_compiled
from ovmot.objects.motion_kernel import moving_points_compiled, points_to_look_at_compiled
from ovmot.physics import (
    ACCEL_SIGMA_MPS2,
    MAX_VEHICLE_SIZE_M,
    TURN_SPREAD_MPS,
    VARIANCE_FACTOR,
    gate,
)
from ovmot.segmentation.motion_tests import velocity_gates
from ovmot.segmentation.static_comparison import ego_motion_since, pairs_of, stereo_noise
from ovmot.settings import ObjectSettings
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_SPREAD_SHARE = 0.05  # of the speed, by which points of one body may differ
_REACH_SIGMAS = 2.0  # of the position, on top of the radius and of a gap
_MOVES = 4.11  # 75 % of the same: less tells no motion
_HINT = 4.0  # squared sigmas that make a point worth a closer look
NEIGHBOUR_RADIUS_M = 1.8  # points of one body have a neighbour within this
_MAX_POINTS = 240  # that are looked at in a frame; those tracked longest come first
_POINTS_PER_TRACK = 40  # of these, points of one track
_NEIGHBOURS = 5  # two linked points are among each other's so many nearest ones
_KNOWN_REACH = 2.0  # of the radius, between parts of one track
_WIDTH_SIGMAS = 4.0  # by which points of one body may scatter beyond it
_LEAST_GAP_M = 0.5  # between two vehicles side by side
_BRAKING_S = 0.45  # over which one velocity explains also a car on its brakes


@dataclass(frozen=True, slots=True)
class MotionHistory:
    """M points that may move, over L earlier rows and now.

    `feature_id` (M,), `track_id` (M,): the object track that holds it, -1 for none; `track_length`
    (L,): frames since. `history` holds the normalized coordinates, `predicted` (L, M, 3) the points
    at rest under the ego motion, `p_cam0` (M, 3) and `cov_cam0` (M, 3, 3) the points now, metres.
    `weight` (L, M, 4, 4): inverse of the comparison's S_motion, zero where untested; `information`
    (L, M, 3, 3): of the displacement since. `velocity` (M, 3) and `velocity_cov` (M, 3, 3): over
    all rows, in the camera's axes; `up` (3,): the world's z.
    """

    feature_id: IntArray
    track_id: IntArray
    history: StereoHistory
    predicted: FloatArray
    p_cam0: FloatArray
    cov_cam0: FloatArray
    weight: FloatArray
    information: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray
    up: FloatArray


def motion_history(
    history: StereoHistory,
    points: ScenePoints,
    window: PoseWindow,
    rig: StereoRig,
    settings: ObjectSettings,
    max_range_m: float,
) -> MotionHistory | None:
    """What the history of a frame's `points` tells of those that may move; None for too few.

    These are points that one velocity explains and that do not seem static. A label `static` is no
    bar: what is too little to tell for a point may be enough for a group.
    """
    pairs, ego = pairs_of(history), ego_motion_since(history, window, rig)
    seems_static = points.label == int(PointLabel.STATIC)
    candidate, known = points_to_look_at_compiled(
        pairs, history.cov_now, ego.T_now_then, seems_static, max_range_m, _HINT
    )
    if len(candidate) < settings.min_points:
        return None
    candidate = candidate[_chosen(known, points.pixels[candidate, 0], points.track_id[candidate])]
    moving = moving_points_compiled(
        pairs, ego, stereo_noise(history, rig), candidate, points.track_id[candidate] >= 0,
        int(np.count_nonzero(history.span_s > _BRAKING_S)), ACCEL_SIGMA_MPS2,
        VARIANCE_FACTOR * velocity_gates(len(history)), _MOVES,
    )  # fmt: skip
    if len(moving.point) < settings.min_points:
        return None
    history = history.only(moving.point)
    return MotionHistory(
        feature_id=history.feature_id,
        track_id=points.track_id[moving.point],
        history=history,
        predicted=moving.predicted,
        p_cam0=history.p_now,
        cov_cam0=history.cov_now,
        weight=moving.weight,
        information=moving.information,
        velocity=moving.velocity,
        velocity_cov=moving.velocity_cov,
        up=(window.T_world_imu[-1] @ rig.T_imu_cam0)[2, :3],
    )


def _chosen(known: IntArray, u: FloatArray, owner: IntArray) -> IntArray:
    """Which of the points (N,) to look at, seen in `known` rows at image columns `u`.

    Of a track as many as tell enough, from all over it, or a large body would leave none for the
    others; then those followed longest.
    """
    looked_at = np.ones(len(owner), dtype=np.bool_)
    track_ids, count = np.unique(owner, return_counts=True)
    for track_id in track_ids[(track_ids >= 0) & (count > _POINTS_PER_TRACK)]:
        own = np.flatnonzero((owner == track_id) & (known > 1))
        if len(own) > _POINTS_PER_TRACK:
            across = own[np.argsort(u[own], kind="stable")]
            looked_at[own] = False
            looked_at[across[:: -(-len(own) // _POINTS_PER_TRACK)]] = True
    some = np.flatnonzero(looked_at)
    if len(some) <= _MAX_POINTS:
        return some
    longest = np.argsort(-known[some], kind="stable")[:_MAX_POINTS]
    return np.sort(some[longest])


def group_points(points: MotionHistory, settings: ObjectSettings) -> tuple[IntArray, ...]:
    """Indices of the points of each cluster, largest first.

    Connected components of neighbours with one velocity. Components that have one velocity, touch,
    and together are no wider than a body are merged. Points of different tracks are never linked:
    walkers side by side stay two.
    """
    scaled = _depth_scaled(points.p_cam0, points.cov_cam0, NEIGHBOUR_RADIUS_M)
    pairs = _neighbour_pairs(scaled, NEIGHBOUR_RADIUS_M)
    pairs = pairs[_same_velocity(points, pairs) & _compatible_pairs(points.track_id[pairs])]
    component = components_compiled(pairs, len(points.feature_id))
    distance = cdist(scaled, scaled)
    several = np.flatnonzero(np.bincount(component) > 1)
    linked = [np.flatnonzero(component == k) for k in several]
    narrow = [part for whole in linked for part in _split_at_gap(points, whole, settings)]
    groups: list[IntArray] = []
    for part in sorted(narrow, key=len, reverse=True):
        for k, group in enumerate(groups):
            if _are_one_body(points, distance, group, part, settings):
                groups[k] = np.concatenate([group, part])
                break
        else:
            groups.append(part)
    return tuple(group for group in groups if len(group) >= settings.min_points)


def _split_at_gap(
    points: MotionHistory, index: IntArray, settings: ObjectSettings
) -> list[IntArray]:
    """A component (n,), or the parts of one that is wider than a body, split at its widest gap.

    Vehicles that start side by side move alike and are linked over the gap between them.
    """
    lateral, sigma = _lateral_positions(points, index)
    order = np.argsort(lateral)
    gaps = np.diff(lateral[order])
    wide = np.ptp(lateral) - _WIDTH_SIGMAS * sigma > MAX_VEHICLE_SIZE_M[1]
    if not wide or gaps.max() < _LEAST_GAP_M + _REACH_SIGMAS * sigma:
        return [index]
    cut = int(np.argmax(gaps)) + 1
    sides = index[order[:cut]], index[order[cut:]]
    return [part for side in sides for part in _split_at_gap(points, side, settings)]


def _lateral_positions(points: MotionHistory, index: IntArray) -> tuple[FloatArray, float]:
    """Horizontal positions (n,) of points across their median velocity, and their standard
    deviation, metres."""
    across = so3.hat(points.up) @ _median(points.velocity[index])
    across = across / max(float(np.linalg.norm(across)), 1e-9)
    variance = _median((points.cov_cam0[index] @ across) @ across)
    return points.p_cam0[index] @ across, float(np.sqrt(variance))


def _median(rows: FloatArray) -> FloatArray:
    """The median of rows (n, ...): of few rows, NumPy's takes several times as long."""
    ordered, n = np.sort(rows, axis=0), len(rows)
    median: FloatArray = 0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])
    return median


def _are_one_body(
    points: MotionHistory,
    distance: FloatArray,
    group: IntArray,
    part: IntArray,
    settings: ObjectSettings,
) -> bool:
    """Do two groups touch, have one velocity, and together measure no more across than a body?"""
    track_id, other = majority_track(points.track_id[group]), majority_track(points.track_id[part])
    if not compatible_tracks(track_id, other):
        return False
    same_track = track_id == other >= 0  # the far end of a lorry
    reach = NEIGHBOUR_RADIUS_M * (_KNOWN_REACH if same_track else 1.0)
    if distance[group[:, None], part].min() > reach:
        return False
    v_group, v_part = (_median(points.velocity[index]) for index in (group, part))
    C = sum(points.velocity_cov[index].mean(0) / len(index) for index in (group, part))
    if not same_body_velocity(v_part, v_group, C, 0.99):
        return False
    lateral, sigma = _lateral_positions(points, np.concatenate([group, part]))
    return bool(np.ptp(lateral) - 2.0 * sigma < MAX_VEHICLE_SIZE_M[1])


def same_body_velocity(
    velocity: FloatArray, of_body: FloatArray, covariance: FloatArray, probability: float
) -> bool:
    """May a velocity (3,) be that of a part of a body with velocity `of_body` (3,), in m/s?

    `covariance` (3, 3): of their difference; to it comes the spread of velocities of a turning
    body. `probability`: of being accepted, for a part of the body.
    """
    spread = TURN_SPREAD_MPS + _SPREAD_SHARE * float(np.linalg.norm(of_body))
    C = covariance + spread**2 * np.eye(3)
    dv = of_body - velocity
    return bool(dv @ np.linalg.solve(C, dv) < gate(3, probability))


def _compatible_pairs(track_ids: IntArray) -> BoolArray:
    """Which pairs of track ids (P, 2) are not two different tracks; -1 is no track."""
    compatible: BoolArray = (track_ids[:, 0] == track_ids[:, 1]) | (track_ids < 0).any(axis=1)
    return compatible


def compatible_tracks(track_id: int, other: int) -> bool:
    """Are these not two different tracks? -1 is no track."""
    return track_id == other or min(track_id, other) < 0


def majority_track(track_id: IntArray) -> int:
    """The track that holds most of the points (n,); -1 where no track holds one."""
    held = track_id[track_id >= 0]
    return int(np.bincount(held).argmax()) if len(held) else -1


def _depth_scaled(p_cam0: FloatArray, cov_cam0: FloatArray, radius: float) -> FloatArray:
    """Points (M, 3) with their depth scaled so that the search radius is the same along the ray.

    The standard deviation of stereo depth is s z², so that the reach along the ray is r + k s z².
    In the depth u(z) = ∫ r dz / (r + k s z²) = sqrt(r / k s) atan(z sqrt(k s / r)) it is r
    everywhere.
    """
    z = p_cam0[:, 2]
    # The difference of two points has √2 times the deviation of one.
    ks = _REACH_SIGMAS * np.sqrt(2.0) * float(np.median(np.sqrt(cov_cam0[:, 2, 2]) / z**2))
    u = np.sqrt(radius / ks) * np.arctan(z * np.sqrt(ks / radius))
    return np.column_stack([p_cam0[:, :2], u])


def _neighbour_pairs(scaled: FloatArray, radius: float) -> IntArray:
    """Pairs (P, 2) of mutual nearest neighbours within `radius`.

    Mutual ones only, so that bodies side by side with many points stay apart.
    """
    n = len(scaled)
    k = min(_NEIGHBOURS + 1, n)
    found = cKDTree(scaled).query(scaled, k=k, distance_upper_bound=radius)
    distance, other = np.asarray(found[0]), np.asarray(found[1])
    a, slot = np.nonzero(np.isfinite(distance[:, 1:]))
    link = np.sort(a * n + other[:, 1:][a, slot])  # from k to m: k n + m
    start, end = np.divmod(link, n)
    mutual = (start < end) & contained(end * n + start, link)
    return np.column_stack([start[mutual], end[mutual]])


def _same_velocity(points: MotionHistory, pairs: IntArray) -> BoolArray:
    """Which pairs (P,) have velocities that agree within their covariance."""
    a, b = pairs[:, 0], pairs[:, 1]
    dv = points.velocity[a] - points.velocity[b]
    C = points.velocity_cov[a] + points.velocity_cov[b] + TURN_SPREAD_MPS**2 * np.eye(3)
    agrees: BoolArray = squared_distance(dv, C) < gate(3, 0.99)
    return agrees
