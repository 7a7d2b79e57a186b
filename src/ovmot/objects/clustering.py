"""Groups of points that are near each other and move alike: the candidates for rigid bodies."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.components_kernel import components_compiled
from ovmot.physics import ACCEL_SIGMA_MPS2, gates
from ovmot.segmentation.history_kernel import (
    distance_from_static_compiled,
    fit_velocities_compiled,
    weigh_compiled,
)
from ovmot.segmentation.motion_tests import SHARED_NOISE
from ovmot.segmentation.static_comparison import (
    StaticComparison,
    compare_with_static,
    static_motion,
)
from ovmot.segmentation.stereo_history import StereoHistory
from ovmot.settings import ObjectSettings
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_SPREAD_SHARE = 0.05  # and as a share of the speed
_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_REACH_SIGMAS = 2.0  # along the ray, on top of the radius
_SPEED_SPREAD = 0.5  # m/s by which points of one turning body may differ
_MOVES = 4.11  # 75 % of the same: less tells no motion
_HINT = 4.0  # squared sigmas that make a point worth a closer look
_NEIGHBOURS = 5  # nearest ones among which two must be to be linked
_KNOWN_REACH = 2.0  # of the radius, between parts of one track
_WIDTH_SIGMAS = 4.0  # by which points of one body may scatter beyond it
_LEAST_GAP_M = 0.5  # between two vehicles side by side
_BRAKING_S = 0.45  # over which one velocity explains also a car on its brakes


@dataclass(frozen=True, slots=True)
class MotionHistory:
    """M points that may move, over L earlier rows and now.

    `feature_id` (M,), `owner` (M,): the track that has it, -1 for none; `track_length` (L,): frames
    since. `history` holds the plane coordinates, `predicted` (L, M, 3) where the ego motion alone
    would put the points, `p_cam0` (M, 3) and `cov_cam0` (M, 3, 3) where they are. `weight` (L, M,
    4, 4): inverse of the comparison's S_motion, zero where untested; `information` (L, M, 3, 3):
    what it tells of the way since. `velocity` (M, 3) and `velocity_cov` (M, 3, 3): over all rows,
    in the camera's axes; `up` (3,): the world's z.
    """

    feature_id: IntArray
    owner: IntArray
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
    T_now_then = static_motion(history, window, rig)
    distance = distance_from_static_compiled(
        history.p_then, history.p_now, history.cov_now, T_now_then
    )
    may_move = distance > _HINT
    may_move |= points.label != int(PointLabel.STATIC)
    with np.errstate(invalid="ignore"):
        near = points.p_cam0[:, 2] < max_range_m
    candidate = np.flatnonzero(near & may_move & np.isfinite(history.p_then[..., 2]).any(0))
    if len(candidate) < settings.min_points:
        return None
    known = np.isfinite(history.p_then[:, candidate, 2]).sum(0)
    u, owner = points.pixels[candidate, 0], points.track_id[candidate]
    candidate = candidate[_chosen(known, u, owner, settings)]
    history = history.only(candidate)
    comparison = compare_with_static(history, window, rig)
    velocity, covariance, steady = _fit(comparison)
    changes = ~steady & (points.track_id[candidate] >= 0)
    if changes.any():
        comparison = _shortened(comparison, changes)
        velocity, covariance, steady = _fit(comparison)
    kept = np.flatnonzero(steady & (squared_distance(velocity, covariance) > _MOVES))
    if len(kept) < settings.min_points:
        return None
    J, S = comparison.J_motion.take(kept, axis=1), comparison.S_motion.take(kept, axis=1)
    weight, information = weigh_compiled(J, S, comparison.tested.take(kept, axis=1))
    history = history.only(kept)
    return MotionHistory(
        feature_id=history.feature_id,
        owner=points.track_id[candidate[kept]],
        history=history,
        predicted=comparison.predicted.take(kept, axis=1),
        p_cam0=history.p_now,
        cov_cam0=history.cov_now,
        weight=weight,
        information=information,
        velocity=velocity[kept],
        velocity_cov=covariance[kept],
        up=(window.T_world_imu[-1] @ rig.T_imu_cam0)[2, :3],
    )


def _chosen(known: IntArray, u: FloatArray, owner: IntArray, settings: ObjectSettings) -> IntArray:
    """Which of the points (N,) to look at, seen in `known` rows at image columns `u`.

    Of a track as many as tell enough, from all over it, or a large body would leave none for the
    others; then those followed longest.
    """
    looked_at = np.ones(len(owner), dtype=np.bool_)
    for track_id in np.unique(owner[owner >= 0]):
        own = np.flatnonzero((owner == track_id) & (known > 1))
        if len(own) > settings.points_per_track:
            across = own[np.argsort(u[own], kind="stable")]
            looked_at[own] = False
            looked_at[across[:: -(-len(own) // settings.points_per_track)]] = True
    some = np.flatnonzero(looked_at)
    longest = np.argsort(-known[some], kind="stable")[: settings.max_points]
    return np.sort(some[longest])


def _fit(comparison: StaticComparison) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Velocity (M, 3), its covariance (M, 3, 3), and whether it explains all rows (M,)."""
    tested, span_s, J = comparison.tested, comparison.span_s, comparison.J_motion
    slack = (0.5 * ACCEL_SIGMA_MPS2 * span_s**2) ** 2
    velocity, covariance, cost = fit_velocities_compiled(
        comparison.residual, J, comparison.S_motion, J, slack, span_s, tested
    )
    steady = cost < SHARED_NOISE * gates(np.maximum(4 * tested.sum(0) - 3, 1), 0.999)
    return velocity, covariance, steady


def _shortened(comparison: StaticComparison, which: BoolArray) -> StaticComparison:
    """Some points (M,) by their last rows alone: a car that brakes was faster before.

    For points of tracks: else any jump of a patch would be a motion.
    """
    old = comparison.span_s > _BRAKING_S
    residual = comparison.residual.copy()
    residual[np.ix_(old, which)] = np.nan
    return replace(comparison, residual=residual)


def group_points(points: MotionHistory, settings: ObjectSettings) -> tuple[IntArray, ...]:
    """Indices of the points of each connected component of like movers, largest first.

    Components that move alike, touch, and together are no wider than a body are one. Points of
    different tracks are not: walkers side by side stay two.
    """
    scaled = _stretched(points.p_cam0, points.cov_cam0, settings.neighbour_radius_m)
    pairs = _near_pairs(scaled, settings.neighbour_radius_m)
    pairs = pairs[_same_velocity(points, pairs) & _may_be_linked(points.owner[pairs])]
    component = components_compiled(pairs, len(points.feature_id))
    apart = cdist(scaled, scaled)
    several = np.flatnonzero(np.bincount(component) > 1)
    found = [np.flatnonzero(component == k) for k in several]
    cut = [piece for whole in found for piece in _cut_where_wide(points, whole, settings)]
    pieces = sorted(cut, key=len, reverse=True)
    joined: list[IntArray] = []
    for piece in pieces:
        for k, whole in enumerate(joined):
            if _are_one(points, apart, whole, piece, settings):
                joined[k] = np.concatenate([whole, piece])
                break
        else:
            joined.append(piece)
    return tuple(group for group in joined if len(group) >= settings.min_points)


def _cut_where_wide(
    points: MotionHistory, index: IntArray, settings: ObjectSettings
) -> list[IntArray]:
    """A component (n,), or the pieces of one that is wider than a body, cut at the widest gap.

    Vehicles that start side by side move alike and are linked over the gap between them.
    """
    place, sigma = _across(points, index)
    order = np.argsort(place)
    gaps = np.diff(place[order])
    wide = np.ptp(place) - _WIDTH_SIGMAS * sigma > settings.body_width_m
    if not wide or gaps.max() < _LEAST_GAP_M + _REACH_SIGMAS * sigma:
        return [index]
    cut = int(np.argmax(gaps)) + 1
    parts = index[order[:cut]], index[order[cut:]]
    return [piece for part in parts for piece in _cut_where_wide(points, part, settings)]


def _across(points: MotionHistory, index: IntArray) -> tuple[FloatArray, float]:
    """Places of points (n,) across their common velocity, level, and their deviation, metres."""
    across = so3.hat(points.up) @ _median(points.velocity[index])
    across = across / max(float(np.linalg.norm(across)), 1e-9)
    variance = _median((points.cov_cam0[index] @ across) @ across)
    return points.p_cam0[index] @ across, float(np.sqrt(variance))


def _median(rows: FloatArray) -> FloatArray:
    """The median of rows (n, ...): of few rows, NumPy's takes several times as long."""
    ordered, n = np.sort(rows, axis=0), len(rows)
    median: FloatArray = 0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])
    return median


def _are_one(
    points: MotionHistory,
    apart: FloatArray,
    whole: IntArray,
    piece: IntArray,
    settings: ObjectSettings,
) -> bool:
    """Do two groups touch, move alike, and together measure no more across than a body?"""
    owner, other = main_owner(points.owner[whole]), main_owner(points.owner[piece])
    if not may_be_one(owner, other):
        return False
    known = owner == other >= 0  # of one track: a lorry's far end
    reach = settings.neighbour_radius_m * (_KNOWN_REACH if known else 1.0)
    if apart[whole[:, None], piece].min() > reach:
        return False
    v_whole, v_piece = (_median(points.velocity[index]) for index in (whole, piece))
    spread = _SPEED_SPREAD + _SPREAD_SHARE * float(np.linalg.norm(v_whole))
    C = spread**2 * np.eye(3)
    for index in (whole, piece):
        C = C + points.velocity_cov[index].mean(0) / len(index)
    dv = v_whole - v_piece
    if dv @ np.linalg.solve(C, dv) > _GATE:
        return False
    place, sigma = _across(points, np.concatenate([whole, piece]))
    return bool(np.ptp(place) - 2.0 * sigma < settings.body_width_m)


def _may_be_linked(owners: IntArray) -> BoolArray:
    """Which pairs of owners (P, 2) are not two different tracks."""
    one: BoolArray = (owners[:, 0] == owners[:, 1]) | (owners < 0).any(axis=1)
    return one


def may_be_one(owner: int, other: int) -> bool:
    """Are these owners of groups not two different tracks?"""
    return owner == other or min(owner, other) < 0


def main_owner(owner: IntArray) -> int:
    """The track that has most of the owned points (n,); -1 where none is owned."""
    owned = owner[owner >= 0]
    return int(np.bincount(owned).argmax()) if len(owned) else -1


def _stretched(p_cam0: FloatArray, cov_cam0: FloatArray, radius: float) -> FloatArray:
    """Points (M, 3) with a depth in which near means within `radius`, as across the ray.

    Along the ray stereo scatters by s z², so that the reach there is r + k s z². In the depth
    u(z) = ∫ r dz / (r + k s z²) = sqrt(r / k s) atan(z sqrt(k s / r)) it is r everywhere.
    """
    z = p_cam0[:, 2]
    # Two points scatter: √2 of one.
    ks = _REACH_SIGMAS * np.sqrt(2.0) * float(np.median(np.sqrt(cov_cam0[:, 2, 2]) / z**2))
    u = np.sqrt(radius / ks) * np.arctan(z * np.sqrt(ks / radius))
    return np.column_stack([p_cam0[:, :2], u])


def _near_pairs(scaled: FloatArray, radius: float) -> IntArray:
    """Pairs (P, 2) within `radius` that are each among the other's nearest few.

    So bodies side by side stay apart where they have many points.
    """
    n = len(scaled)
    k = min(_NEIGHBOURS + 1, n)
    found = cKDTree(scaled).query(scaled, k=k, distance_upper_bound=radius)
    apart, other = np.asarray(found[0]), np.asarray(found[1])
    a, slot = np.nonzero(np.isfinite(apart[:, 1:]))
    link = np.sort(a * n + other[:, 1:][a, slot])  # from k to m: k n + m
    start, end = np.divmod(link, n)
    mutual = (start < end) & contained(end * n + start, link)
    return np.column_stack([start[mutual], end[mutual]])


def _same_velocity(points: MotionHistory, pairs: IntArray) -> BoolArray:
    """Which pairs (P,) have velocities that agree within their covariance."""
    a, b = pairs[:, 0], pairs[:, 1]
    dv = points.velocity[a] - points.velocity[b]
    C = points.velocity_cov[a] + points.velocity_cov[b] + _SPEED_SPREAD**2 * np.eye(3)
    agrees: BoolArray = squared_distance(dv, C) < _GATE
    return agrees
