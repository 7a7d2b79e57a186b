"""What the doctor looks at: stretches of consecutive frames, matched by the front end."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import EpipolarSettings, TrackerSettings
from ovmot.datasets.sequence import FolderSequence
from ovmot.datasets.stream import events
from ovmot.doctor.images import PairLook, look_at
from ovmot.frontend.tracker import StereoTracker
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import solve_stereo_motion
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.types import FrontendFrame, ImuData, StereoFrame

N_STRETCHES, STRETCH_FRAMES = 3, 30
_PIXEL_SIGMA = 0.5
_ROTATION_SIGMAS = (0.004, 0.02)  # rad: how far the rays mislead, by and large and at most
_ROUNDS = 5
_LEAST_POINTS = 8


@dataclass(frozen=True, slots=True)
class Turns:
    """Rotations of the left camera between N pairs of consecutive frames.

    `start_ns`, `end_ns` (N,): stamps of the two frames; `rotation` (N, 3): rotation vector in rad
    of the camera in its own axes, NaN where the images do not tell it.
    """

    start_ns: IntArray
    end_ns: IntArray
    rotation: FloatArray


@dataclass(frozen=True, slots=True)
class Observations:
    """What the sampled frames show: stereo matches (M, 4) in pixels, unchecked; turns; pictures."""

    matches: FloatArray
    turns: Turns
    pictures: tuple[PairLook, ...]


def choose_stretches(frame_ns: IntArray, imu: ImuData | None) -> list[tuple[int, int]]:
    """First and last frames of the stretches: all of a short sequence, else one of each third.

    In each third, the stretch is taken in which the gyroscope varies most, so that rotations can
    be compared; without an IMU, the middle.
    """
    n = len(frame_ns)
    if n <= N_STRETCHES * STRETCH_FRAMES:
        return [(0, n - 1)]
    edges = np.linspace(0, n, N_STRETCHES + 1).astype(np.int64)
    stretches = []
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        last = high - STRETCH_FRAMES
        starts = range(low, last + 1, max(1, (last - low) // 20))
        start = (low + last) // 2
        if imu is not None:
            start = max(starts, key=lambda i: _turning(imu, frame_ns[i : i + STRETCH_FRAMES]))
        stretches.append((start, start + STRETCH_FRAMES - 1))
    return stretches


def _turning(imu: ImuData, frame_ns: IntArray) -> float:
    """Variance of the gyroscope over a stretch."""
    low, high = np.searchsorted(imu.timestamp_ns, (frame_ns[0], frame_ns[-1]))
    return float(imu.gyro[low:high].var(axis=0).sum()) if high - low > 1 else 0.0


def observe(
    sequence: FolderSequence, stretches: list[tuple[int, int]], advance: Callable[[int], None]
) -> Observations:
    """Follow and match features through the stretches; `advance` hears how many frames are done.

    Raises `DatasetError` for a broken image.
    """
    matches: list[FloatArray] = []
    turns: list[tuple[int, int, FloatArray]] = []
    pictures: list[PairLook] = []
    for first, last in stretches:
        for frame, pixels, turn in _stretch(sequence, first, last):
            matches.append(pixels)
            pictures.append(look_at(frame, pictures[-1] if pictures else None))
            if turn is not None:
                turns.append(turn)
            advance(len(pictures))
    return Observations(np.concatenate(matches), _joined(turns), tuple(pictures))


def _stretch(
    sequence: FolderSequence, first: int, last: int
) -> Iterator[tuple[StereoFrame, FloatArray, tuple[int, int, FloatArray] | None]]:
    """Each frame, its stereo matches (M, 4), and its turn since the frame before."""
    tracker = StereoTracker(sequence.rig, TrackerSettings(), EpipolarSettings())
    before: FrontendFrame | None = None
    T_now_before = np.eye(4)  # predicted by the last one
    try:
        for event in events(sequence, first=first, last=last):
            if not isinstance(event, StereoFrame):
                continue
            now, tested = tracker.track(event, T_now_before)
            turn = None
            if before is not None:
                moved = camera_motion(before, now, sequence.rig)
                T_now_before = np.eye(4) if moved is None else moved
                rotation = np.full(3, np.nan) if moved is None else so3.log(moved[:3, :3].T)
                turn = before.timestamp_ns, now.timestamp_ns, rotation
            yield event, tested.pixels, turn
            before = now
    finally:
        tracker.close()


def camera_motion(before: FrontendFrame, now: FrontendFrame, rig: StereoRig) -> FloatArray | None:
    """T_now_before (4, 4) of the left camera from the stereo points that both frames hold."""
    _, i, j = np.intersect1d(before.feature_id, now.feature_id, return_indices=True)
    sigma = _PIXEL_SIGMA / np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    old, new = before.normalized[i], now.normalized[j]
    depth = triangulate_stereo(old, rig.T_cam1_cam0)[:, 2]
    far = depth >= np.nanmedian(depth) if np.isfinite(depth).any() else depth > 0.0
    if far.sum() < _LEAST_POINTS:
        return None
    R_now_before = rotation_of_rays(old[far, :2], new[far, :2])
    # a wide gate lets a passing body in, a narrow one may leave the scene out
    tried = [
        solve_stereo_motion(old, new, rig.T_cam1_cam0, R_now_before, sigma, rotation_sigma)
        for rotation_sigma in _ROTATION_SIGMAS
    ]
    motions = [motion for motion in tried if motion is not None]
    if not motions:
        return None
    return max(motions, key=lambda motion: int(motion.inlier.sum())).T_now_before


def rotation_of_rays(before: FloatArray, now: FloatArray) -> FloatArray:
    """R_now_before (3, 3) that best turns the rays of plane points `before` (N, 2) into `now`.

    Wahba's problem by SVD (F. L. Markley, 1988), with the weights of least absolute deviations.
    """
    rays = [np.concatenate([xy, np.ones((len(xy), 1))], axis=1) for xy in (before, now)]
    f0, f1 = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    weight, R = np.ones(len(f0)), np.eye(3)
    for _ in range(_ROUNDS):
        R = so3.project_to_rotation((weight[:, None] * f1).T @ f0)
        off = np.linalg.norm(f1 - f0 @ R.T, axis=1)
        weight = 1.0 / np.maximum(off, 1e-3)
    return R


def _joined(turns: list[tuple[int, int, FloatArray]]) -> Turns:
    starts, ends = ([t[k] for t in turns] for k in (0, 1))
    rotation = np.array([t[2] for t in turns]).reshape(-1, 3)
    return Turns(np.array(starts, np.int64), np.array(ends, np.int64), rotation)
