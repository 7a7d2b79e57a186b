"""Clusters of neighbouring points with one velocity: the candidates for rigid bodies."""

from dataclasses import dataclass
from math import hypot

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.bodies_kernel import velocity_distance_compiled
from ovmot.objects.clustering_kernel import SPREAD_SHARE, PointMotions, cluster_compiled
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

_MOVES = 4.11  # 75 % of the same: less tells no motion
_HINT = 4.0  # squared sigmas that make a point worth a closer look
_MAX_POINTS = 240  # that are looked at in a frame; those tracked longest come first
_POINTS_PER_TRACK = 40  # of these, points of one track
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
    noise = stereo_noise(history, history.noise.sigma_px, rig)
    moving = moving_points_compiled(
        pairs, ego, noise, candidate, points.track_id[candidate] >= 0,
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


def group_points(points: MotionHistory, settings: ObjectSettings) -> tuple[IntArray, IntArray]:
    """Indices of the points (K,) of all clusters, one after the other, and the sizes (G,)."""
    return cluster_compiled(
        PointMotions(
            points.p_cam0, points.cov_cam0, points.velocity, points.velocity_cov, points.track_id,
            np.ascontiguousarray(points.up),
        ),
        TURN_SPREAD_MPS, MAX_VEHICLE_SIZE_M[1], gate(3, 0.99), settings.min_points,
    )  # fmt: skip


def same_body_velocity(
    velocity: FloatArray, of_body: FloatArray, covariance: FloatArray, probability: float
) -> bool:
    """May a velocity (3,) be that of a part of a body with velocity `of_body` (3,), in m/s?

    `covariance` (3, 3): of their difference; to it comes the spread of velocities of a turning
    body. `probability`: of being accepted, for a part of the body.
    """
    spread = TURN_SPREAD_MPS + SPREAD_SHARE * hypot(*of_body)
    distance = velocity_distance_compiled(
        of_body - velocity, np.ascontiguousarray(covariance), spread
    )
    return distance < gate(3, probability)


def compatible_tracks(track_id: int, other: int) -> bool:
    """Are these not two different tracks? -1 is no track."""
    return track_id == other or min(track_id, other) < 0


def majority_track(track_id: IntArray) -> int:
    """The track that holds most of the points (n,); -1 where no track holds one."""
    held = track_id[track_id >= 0]
    return int(np.bincount(held).argmax()) if len(held) else -1
