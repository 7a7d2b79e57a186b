"""Clusters of neighbouring points with one velocity: the candidates for rigid bodies."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.clustering_kernel import OneBody, PointMotions, cluster_compiled
from ovmot.objects.motion_kernel import Limits, moving_points_compiled, points_to_look_at_compiled
from ovmot.physics import (
    ACCEL_SIGMA_MPS2,
    CAR_SIZE_M,
    MAX_VEHICLE_SIZE_M,
    SIGMAS_95,
    STEADY_S,
    TURN_SPREAD_MPS,
    VARIANCE_FACTOR,
    gate,
)
from ovmot.segmentation.motion_tests import velocity_gates
from ovmot.segmentation.static_comparison import ego_motion_since, pairs_of, stereo_noise
from ovmot.settings import ObjectSettings
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_MOVES = gate(3, 0.75)  # nearer to rest, a point tells no motion, and is not worth a closer look
_POINTS_PER_TRACK = 40  # of these, points of one track
MAX_POINTS = 240
"""That are looked at in a frame; those tracked longest come first."""
ONE_BODY = OneBody(
    radius_m=CAR_SIZE_M[1],  # a car's back has texture at both its edges, if nowhere else
    velocity_gate=gate(3, 0.99),
    turn_mps=TURN_SPREAD_MPS,
    width_m=MAX_VEHICLE_SIZE_M[1],
    sigmas=SIGMAS_95,
)


@dataclass(frozen=True, slots=True)
class MotionHistory:
    """M points that may move, over L earlier rows and now.

    `index` (M,): which they are in `history`, that of all points of the frame; `feature_id`,
    `track_id` (M,): the object track that holds it, -1 for none. `predicted` (M, L, 3): the points
    at rest under the ego motion, `p_cam0` (M, 3) and `cov_cam0` (M, 3, 3) the points now, metres.
    `weight` (M, L, 4, 4): inverse of the comparison's S_motion, zero where untested; `information`
    (M, L, 3, 3): of the displacement since. `velocity` (M, 3) and `velocity_cov` (M, 3, 3): over
    all rows, in the camera's axes; `up` (3,): the world's z.
    """

    index: IntArray
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
    candidate = points_to_look_at_compiled(
        pairs, history.cov_now, ego.T_now_then, points.label == int(PointLabel.STATIC),
        points.pixels, points.track_id, Limits(max_range_m, _MOVES, MAX_POINTS, _POINTS_PER_TRACK),
    )  # fmt: skip
    if len(candidate) < settings.min_points:
        return None
    moving = moving_points_compiled(
        pairs, ego, stereo_noise(history, history.noise.sigma_px, rig), candidate, points.track_id,
        int(np.count_nonzero(history.span_s > 0.5 * STEADY_S)), ACCEL_SIGMA_MPS2,
        VARIANCE_FACTOR * velocity_gates(len(history)), _MOVES,
    )  # fmt: skip
    index = moving.point
    if len(index) < settings.min_points:
        return None
    return MotionHistory(
        index=index,
        feature_id=history.feature_id[index],
        track_id=points.track_id[index],
        history=history,
        predicted=moving.predicted,
        p_cam0=history.p_now[index],
        cov_cam0=history.cov_now[index],
        weight=moving.weight,
        information=moving.information,
        velocity=moving.velocity,
        velocity_cov=moving.velocity_cov,
        up=(window.T_world_imu[-1] @ rig.T_imu_cam0)[2, :3],
    )


def group_points(points: MotionHistory, settings: ObjectSettings) -> tuple[IntArray, IntArray]:
    """Indices of the points (K,) of all clusters, one after the other, and the sizes (G,)."""
    return cluster_compiled(
        PointMotions(
            points.p_cam0, points.cov_cam0, points.velocity, points.velocity_cov, points.track_id,
            np.ascontiguousarray(points.up),
        ),
        ONE_BODY, settings.min_points,
    )  # fmt: skip
