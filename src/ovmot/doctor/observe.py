"""What the doctor looks at: stretches of consecutive frames, matched by the front end."""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.stream import events
from ovmot.doctor.images import ImageStatistics, image_statistics
from ovmot.errors import DatasetError
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.interfaces import no_feedback
from ovmot.settings import Settings
from ovmot.types import ImuData, StereoFrame

N_STRETCHES, STRETCH_FRAMES = 3, 30
LEAST_POINTS = 8
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class FrameMatches:
    """Stereo matches at one stamp, unchecked: ids (M,) and pixels (M, 4) of both sides."""

    timestamp_ns: int
    feature_id: IntArray
    pixels: FloatArray


@dataclass(frozen=True, slots=True)
class Observations:
    """What the sampled frames show: a tuple of matches for each stretch, and all the images.

    `broken` has a line for each pair that could not be read.
    """

    stretches: tuple[tuple[FrameMatches, ...], ...]
    images: tuple[ImageStatistics, ...]
    broken: tuple[str, ...] = ()

    @property
    def matches(self) -> FloatArray:
        """All stereo matches (N, 4) in pixels."""
        return np.concatenate([seen.pixels for stretch in self.stretches for seen in stretch])


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
    sequence: RecordedSequence, stretches: list[tuple[int, int]], settings: Settings,
    advance: Callable[[int], None],
) -> Observations:  # fmt: skip
    """Follow and match features through the stretches; `advance` hears how many frames are done.

    By optical flow, which takes nothing from the extrinsics: they are what is examined. Pairs that
    cannot be read are left out. Raises `DatasetError` where none can.
    """
    by_flow = settings.tracker.model_copy(update={"stereo_search": "flow"})
    seen: list[tuple[FrameMatches, ...]] = []
    images: list[ImageStatistics] = []
    broken: list[DatasetError] = []
    for first, last in stretches:
        tracker = StereoTracker(sequence.rig, by_flow, settings.epipolar)
        stretch: list[FrameMatches] = []
        T_now_before = np.eye(4)  # as the last one
        with closing(tracker):
            for frame in _readable(sequence, first, last, broken):
                _, tested = tracker.track(frame, T_now_before, no_feedback(sequence.rig))
                stretch.append(FrameMatches(frame.timestamp_ns, tested.feature_id, tested.pixels))
                if len(stretch) > 1:
                    R = rotation_between(stretch[-2], stretch[-1], sequence.rig.cam0)
                    T_now_before = se3.make(R, np.zeros(3))
                images.append(image_statistics(frame, images[-1] if images else None))
                advance(len(images) + len(broken))
        seen.append(tuple(stretch))
    if broken and not images:
        raise broken[0]
    return Observations(tuple(seen), tuple(images), tuple(str(error) for error in broken))


def _readable(
    sequence: RecordedSequence, first: int, last: int, broken: list[DatasetError]
) -> Generator[StereoFrame, None, None]:
    """The stereo frames `first` to `last` that can be read; why not goes into `broken`."""
    at = first
    while at <= last:
        with closing(events(sequence, first=at, last=last)) as stream:
            try:
                for event in stream:
                    if isinstance(event, StereoFrame):
                        at += 1
                        yield event
                return
            except DatasetError as error:
                broken.append(error)
                at += 1


def rotation_between(before: FrameMatches, now: FrameMatches, camera: Camera) -> FloatArray:
    """R_now_before (3, 3) of the left camera by its rays alone, near ones too."""
    _, i, j = np.intersect1d(before.feature_id, now.feature_id, return_indices=True)
    xy = [camera.normalize(pixels[:, :2]) for pixels in (before.pixels[i], now.pixels[j])]
    ok = np.isfinite(np.concatenate(xy, axis=1)).all(axis=1)
    return rotation_of_rays(xy[0][ok], xy[1][ok]) if ok.sum() >= LEAST_POINTS else np.eye(3)


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
