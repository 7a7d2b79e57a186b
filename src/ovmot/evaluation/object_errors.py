"""How far matched tracks are from their objects: velocity, heading, box, motion, and how late."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, must_be_found
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class PairErrors:
    """Errors of M matched pairs, estimate minus truth.

    `velocity` (M, 3) in the body frame, m/s, and `velocity_world` in the run's world, of which
    `velocity_sigma` (M, 3) is the stated one-sigma; `speed` (M,) of the horizontal part;
    `position_world` (M, 3) of the box's centre in the run's world, with `position_sigma` (M, 3);
    `yaw_rate` (M,) rad/s; `heading` (M,) rad in -π..π; `size` (M, 3) m; `box_sigma` (M, 5) of size,
    heading and yaw rate; `distance` (M,) of the centre to the true box, m.
    `motion_m`, `motion_rad` (M,): of the motion to the next frame, see `motion_errors`.
    """

    velocity: FloatArray
    velocity_world: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray
    heading: FloatArray
    size: FloatArray
    distance: FloatArray
    velocity_sigma: FloatArray
    position_world: FloatArray
    position_sigma: FloatArray
    box_sigma: FloatArray
    motion_m: FloatArray
    motion_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Latency:
    """Seconds from when an object has to be found to its first match; `never` were not found."""

    seconds: FloatArray
    never: int


def pair_errors(frames: Sequence[ComparedFrame]) -> PairErrors:
    """The errors of all matched pairs of all frames, the motion errors of those that go on."""
    each = [_frame_errors(frame) for frame in frames]
    motion = [motion_errors(a, b) for a, b in pairwise(frames)]
    none = np.empty(0), np.empty(0)
    columns = [*zip(*each, strict=True), *zip(none, *motion, strict=True)]
    return PairErrors(*(np.concatenate(column) for column in columns))


def _frame_errors(frame: ComparedFrame) -> tuple[FloatArray, ...]:
    """The fields of `PairErrors` but the last two, of one frame."""
    i, j = frame.pairs.T
    objects, tracks = frame.objects, frame.tracks
    R_body_true, R_body_run = frame.T_true[:3, :3].T, frame.T_run[:3, :3].T
    T_run_true = frame.T_run @ se3.inverse(frame.T_true)
    v_true = objects.velocity[i] @ R_body_true.T
    v_run = tracks.velocity[j] @ R_body_run.T
    turn = _yaw(frame.T_true[:3, :3] @ R_body_run)
    heading = tracks.yaw[j] + turn - objects.yaw[i]
    speed = np.linalg.norm(tracks.velocity[j, :2], axis=1)
    return (
        v_run - v_true,
        (v_run - v_true) @ frame.T_run[:3, :3].T,
        speed - np.linalg.norm(objects.velocity[i, :2], axis=1),
        tracks.yaw_rate[j] - objects.yaw_rate[i],
        np.arctan2(np.sin(heading), np.cos(heading)),
        tracks.size[j] - objects.size[i],
        frame.distance[i, j],
        tracks.std[j, 3:],
        tracks.position[j] - se3.apply(T_run_true, objects.center[i]),
        tracks.std[j, :3],
        tracks.std_box[j],
    )


def motion_errors(now: ComparedFrame, later: ComparedFrame) -> tuple[FloatArray, FloatArray]:
    """Errors (M,) in m and rad of the objects' motion from one frame to the next.

    In the object's own frame the true motion is T_obj(k)⁻¹ T_obj(k+1), the estimated one turns by
    yaw rate · dt and moves by velocity · dt. The error is (estimated)⁻¹ · (true), as in the
    evaluation of dynamic SLAM (J. Zhang et al., VDO-SLAM, arXiv:2005.11052).
    """
    i, j = now.pairs.T
    goes_on = np.isin(now.objects.object_id[i], later.objects.object_id)
    i, j = i[goes_on], j[goes_on]
    next_row = {int(o): row for row, o in enumerate(later.objects.object_id)}
    k = np.array([next_row[int(o)] for o in now.objects.object_id[i]], dtype=np.int64)
    dt = (later.objects.timestamp_ns - now.objects.timestamp_ns) * 1e-9
    T_now = _poses(now.objects.yaw[i], now.objects.center[i])
    T_later = _poses(later.objects.yaw[k], later.objects.center[k])
    true = se3.inverse(T_now) @ T_later
    # the velocity, turned from the run's world into the true one, as the object's frame sees it
    R_true_run = now.T_true[:3, :3] @ now.T_run[:3, :3].T
    velocity = now.tracks.velocity[j] @ R_true_run.T
    along = np.einsum("nji,nj->ni", T_now[:, :3, :3], velocity) * dt
    estimated = _poses(now.tracks.yaw_rate[j] * dt, along)
    error = se3.inverse(estimated) @ true
    angle = np.linalg.norm(so3.log(error[:, :3, :3]), axis=1)
    return np.linalg.norm(error[:, :3, 3], axis=1), np.asarray(angle)


def detection_latency(frames: Sequence[ComparedFrame]) -> Latency:
    """Per object, from the first frame in which it has to be found to its first match."""
    needed_since: dict[int, int] = {}
    found: dict[int, float] = {}
    for frame in frames:
        now = frame.objects.timestamp_ns
        for object_id in frame.objects.object_id[frame.needed].tolist():
            needed_since.setdefault(object_id, now)
        for object_id in frame.objects.object_id[frame.pairs[:, 0]].tolist():
            found.setdefault(object_id, 1e-9 * (now - needed_since[object_id]))
    return Latency(np.array(list(found.values())), len(needed_since) - len(found))


def pull_out_latency(frames: Sequence[ComparedFrame], criteria: ObjectCriteria) -> Latency:
    """Per object that pulls out, from reaching the speed to its first confirmed track.

    An object pulls out at the first frame at which it is as fast as that, where it was seen slower
    in the frame before, and is then as near, as large in the image, and ahead; nothing else that
    it does later counts. One that had a track before is found after 0 s.
    """
    fast: set[int] = set()
    present: set[int] = set()
    since: dict[int, int] = {}
    found: dict[int, int] = {}
    for frame in frames:
        objects, now = frame.objects, frame.objects.timestamp_ns
        quick = np.linalg.norm(objects.velocity, axis=1) >= criteria.min_speed_mps
        close = must_be_found(objects, frame.T_true, criteria)
        for row in np.flatnonzero(quick).tolist():
            object_id = int(objects.object_id[row])
            if close[row] and object_id in present - fast:
                since[object_id] = now
            fast.add(object_id)
        present = set(objects.object_id.tolist())
        for object_id in objects.object_id[frame.pairs[:, 0]].tolist():
            found.setdefault(object_id, now)
    late = [1e-9 * max(found[i] - since[i], 0) for i in since if i in found]
    return Latency(np.array(late), len(since) - len(late))


def _poses(yaw: FloatArray, position: FloatArray) -> FloatArray:
    R = so3.exp(yaw[:, None] * np.array([0.0, 0.0, 1.0]))
    return se3.make(R, position)


def _yaw(R: FloatArray) -> float:
    return float(np.arctan2(R[1, 0], R[0, 0]))
