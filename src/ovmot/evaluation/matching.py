"""Assignment of tracks to true objects, frame by frame.

Tracks and objects are compared in the body frame, so that drift of the trajectory is not counted
twice. A track's centre is that of the surface it sees: its distance is that to the true box, zero
inside. Objects that nobody has to find (parked, slow, hidden, far, behind) are neither hit nor
miss: the tracks that lie on them leave the count with them (as KITTI's evaluation treats regions
that it does not care for; A. Geiger et al., CVPR 2012).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ovmot.datasets.truth import ObjectTruth, TrueObjects
from ovmot.evaluation.tracking import TrackingSequence
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.outputs.run_reader import Tracks

_FAR = 1e6


@dataclass(frozen=True, slots=True)
class ObjectCriteria:
    """Which objects have to be found, and how near a track must be."""

    min_pixels: int = 350
    min_speed_mps: float = 1.0
    max_range_m: float = 40.0
    gate_m: float = 2.5


@dataclass(frozen=True, slots=True)
class ComparedFrame:
    """One frame: N true objects, P tracks, and their assignment.

    `T_true`, `T_run` (4, 4): the rig in both worlds. `needed` (N,): has to be found. `counted`
    (P,): not on an object that need not be found. `pairs` (M, 2): indices of a needed object and
    its track. `distance` (N, P) in m.
    """

    objects: TrueObjects
    tracks: Tracks
    T_true: FloatArray
    T_run: FloatArray
    needed: BoolArray
    counted: BoolArray
    pairs: IntArray
    distance: FloatArray


def compare_frames(
    timestamp_ns: IntArray,
    T_true: FloatArray,
    T_run: FloatArray,
    truth: ObjectTruth,
    tracks: Tracks,
    criteria: ObjectCriteria,
) -> tuple[ComparedFrame, ...]:
    """All frames for which the run has a pose and the truth has objects' states.

    `T_true`, `T_run` (N, 4, 4): poses of the rig at stamps (N,). Tracks at other stamps do not
    count.
    """
    frames = []
    for stamp, true_pose, run_pose in zip(timestamp_ns.tolist(), T_true, T_run, strict=True):
        objects = truth.frames.get(stamp)
        if objects is not None:
            now = tracks.at(stamp)
            left_out = None
            if truth.image_rules is not None:
                p_imu = se3.apply(se3.inverse(run_pose), now.position)
                left_out = truth.image_rules.leave_out(stamp, p_imu, now.size[:, 2])
            frames.append(compare_frame(objects, now, true_pose, run_pose, criteria, left_out))
    return tuple(frames)


def compare_frame(
    objects: TrueObjects,
    tracks: Tracks,
    T_true: FloatArray,
    T_run: FloatArray,
    criteria: ObjectCriteria,
    left_out: BoolArray | None = None,
) -> ComparedFrame:
    """Pair the objects and tracks of one frame by the least total distance within the gate.

    `left_out` (P,): tracks that the data's own rules do not count where they are on no object.
    """
    T_true_run = T_true @ se3.inverse(T_run)
    distance = box_distances(se3.apply(T_true_run, tracks.position), objects)
    needed = must_be_found(objects, T_true, criteria)
    near = distance < criteria.gate_m
    of_object, of_track = linear_sum_assignment(np.where(near, distance, _FAR))
    kept = near[of_object, of_track]
    of_object, of_track = of_object[kept], of_track[kept]
    counted = np.ones(len(tracks.track_id), dtype=np.bool_) if left_out is None else ~left_out
    counted[of_track] = True
    counted[of_track[~needed[of_object]]] = False
    pairs = np.stack([of_object, of_track], axis=1)[needed[of_object]]
    return ComparedFrame(
        objects, tracks, T_true, T_run, needed, counted, pairs.astype(np.int64), distance
    )


def box_distances(points: FloatArray, objects: TrueObjects) -> FloatArray:
    """Distances (N, P) in m from points (P, 3) to the objects' boxes; 0 inside."""
    offset = points[None, :, :] - objects.center[:, None, :]
    c, s = np.cos(objects.yaw)[:, None], np.sin(objects.yaw)[:, None]
    along = c * offset[..., 0] + s * offset[..., 1]
    across = -s * offset[..., 0] + c * offset[..., 1]
    local = np.abs(np.stack([along, across, offset[..., 2]], axis=-1))
    outside = np.maximum(local - 0.5 * objects.size[:, None, :], 0.0)
    distance: FloatArray = np.linalg.norm(outside, axis=-1)
    return distance


def must_be_found(objects: TrueObjects, T_true: FloatArray, criteria: ObjectCriteria) -> BoolArray:
    """Which objects (N,) move, are seen, near and ahead (x forward in the body frame)."""
    p_body = se3.apply(se3.inverse(T_true), objects.center)
    speed = np.linalg.norm(objects.velocity, axis=1)
    found: BoolArray = (
        (objects.visible_px >= criteria.min_pixels)
        & (speed >= criteria.min_speed_mps)
        & (np.linalg.norm(p_body, axis=1) < criteria.max_range_m)
        & (p_body[:, 0] > 0.0)
    )
    return found if objects.evaluated is None else found & objects.evaluated


def tracking_sequence(frames: Sequence[ComparedFrame], gate_m: float) -> TrackingSequence:
    """What the tracking metrics take: needed objects and counted tracks.

    The similarity is 1 - d / (2 gate), so that the usual threshold of 0.5 is the gate.
    """
    similarity = [
        np.maximum(0.0, 1.0 - f.distance[np.ix_(f.needed, f.counted)] / (2.0 * gate_m))
        for f in frames
    ]
    return TrackingSequence(
        tuple(f.objects.object_id[f.needed] for f in frames),
        tuple(f.tracks.track_id[f.counted] for f in frames),
        tuple(similarity),
    )
