"""What a sequence to be written is, and what the writers of all formats share.

A writer takes a folder and a `SequenceToWrite`, writes the files of its format, and yields each
frame's time in ns when all its images are on disk. The truth goes into `truth/` (see
`ovmot.datasets.truth`), `objects.json` last: a folder without it was interrupted.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import (
    TrueObjects,
    depth_image,
    object_entry,
    write_imu_errors,
    write_object_truth,
)
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.geometry.arrays import AnyArray, FloatArray, Image, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.types import ImuData, ImuNoise, StereoFrame

_WRITERS, _FRAMES_IN_FLIGHT = 2, 4
_PNG_FAST = (
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FrameToWrite:
    """A stereo pair and the truth behind it.

    `left_id`, `right_id` (H, W): the object's id at every pixel, 0 where no object is; `depth`
    (H, W): metres along the left camera's z axis, infinite or NaN where there is none.
    """

    frame: StereoFrame
    left_id: Image
    right_id: Image
    depth: AnyArray
    objects: TrueObjects


@dataclass(frozen=True, slots=True)
class ImuToWrite:
    """IMU samples (N,) with the true biases (N, 3) in them, rad/s and m/s², and what is known of
    the sensor: its rate, noise densities, and systematic errors by name (None where it has none).
    """

    data: ImuData
    gyro_bias: FloatArray
    accel_bias: FloatArray
    rate_hz: float
    noise: ImuNoise
    errors: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class SequenceToWrite:
    """A stereo-inertial sequence with its truth, whatever it comes from.

    `camera_ns` (M,) are the exposures; `path` is the true T_world_imu(t) in the cameras' time;
    `T_vehicle_imu` (4, 4) where the IMU sits on the vehicle. `frames` gives the stereo frames that
    a rig at the same place sees, in order: formats of rectified images ask for another rig than
    `rig`, and a second call gives the same frames again.
    """

    rig: StereoRig
    camera_ns: IntArray
    path: PoseSpline
    T_vehicle_imu: FloatArray
    imu: ImuToWrite
    frames: Callable[[StereoRig], Iterator[FrameToWrite]]


class Writer(Protocol):
    """Writes a sequence in one format."""

    def __call__(self, folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
        """Yield the time in ns of each frame, when it is on disk.

        The same sequence gives the same bytes. Raises `InputError` where the folder is not empty or
        not writable, or where the format cannot hold the rig.
        """
        ...


SaveImages = Callable[[FrameToWrite], None]
"""Writes the images of a frame where a format has them; called in threads."""


@contextmanager
def writable(folder: Path) -> Iterator[None]:
    """Turn an `OSError` of the writing within into an `InputError` that names the folder."""
    try:
        yield
    except OSError as error:
        raise InputError.at(folder, f"cannot be written: {error.strerror}") from error


def make_folders(folder: Path, names: tuple[str, ...]) -> None:
    """Make an empty folder's parts and those of the truth; `InputError` where it is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError.at(folder, "exists and is not an empty folder", "choose another")
    for name in (*names, "truth/depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)


def truth_times(sequence: SequenceToWrite) -> IntArray:
    """Stamps (N,) of the true poses, by the cameras' clock: every frame's, and the IMU's rate."""
    first, last = sequence.camera_ns[0], sequence.camera_ns[-1]
    period_ns = round(1e9 / sequence.imu.rate_hz)
    regular = np.arange(first, last + 1, period_ns, dtype=np.int64)
    return np.union1d(regular, sequence.camera_ns)


def write_true_poses(folder: Path, sequence: SequenceToWrite) -> None:
    """Write truth/poses.csv: ns, IMU position, quaternion w x y z."""
    times = truth_times(sequence)
    T_world_imu = sequence.path.pose(times)
    wxyz = so3.to_quaternion(T_world_imu[:, :3, :3])[:, [3, 0, 1, 2]]
    poses = np.concatenate([T_world_imu[:, :3, 3], wxyz], axis=1)
    write_rows(folder / "truth/poses.csv", times, poses)


def write_rows(
    path: Path, times: IntArray, values: FloatArray, header: str = "", separator: str = ","
) -> None:
    """A line per row: the stamp of `times` (N,) as an integer, then `values` (N, K) with nine
    decimals."""
    with path.open("w", encoding="utf-8") as file:
        if header:
            file.write(f"{header}\n")
        for time_ns, row in zip(times.tolist(), values.tolist(), strict=True):
            fields = (str(time_ns), *(f"{x:.9f}" for x in row))
            file.write(separator.join(fields) + "\n")


def write_imu_truth(folder: Path, imu: ImuToWrite) -> None:
    """Write truth/imu.csv and, where there are errors, truth/imu_errors.yaml."""
    header = "#timestamp_ns," + ",".join(f"{s}_bias_{c}" for s in ("gyro", "accel") for c in "xyz")
    biases = np.concatenate([imu.gyro_bias, imu.accel_bias], axis=1)
    write_rows(folder / "truth/imu.csv", imu.data.timestamp_ns, biases, header)
    if imu.errors is not None:
        write_imu_errors(folder / "truth/imu_errors.yaml", imu.errors)


def by_stamp(left: Path, right: Path) -> SaveImages:
    """Images named `<ns>.png` in a folder of each camera."""

    def save(frame: FrameToWrite) -> None:
        name = f"{frame.frame.timestamp_ns}.png"
        write_png(left / name, frame.frame.left)
        write_png(right / name, frame.frame.pair[1])

    return save


def write_frames(
    folder: Path, sequence: SequenceToWrite, rig: StereoRig, save: SaveImages
) -> Iterator[int]:
    """Have the images that `rig` sees saved, and write the frames' truth into `folder`.

    Yields each frame's time in ns when all its images are on disk; they are encoded in threads of
    their own. Raises `OSError` where they cannot be written.
    """
    entries = []
    pending: deque[tuple[int, Future[None]]] = deque()
    with ThreadPoolExecutor(max_workers=_WRITERS) as pool:
        for frame in sequence.frames(rig):
            time_ns = frame.frame.timestamp_ns
            pending.append((time_ns, pool.submit(_write_frame, folder, save, frame)))
            entries.append(object_entry(frame.objects, sequence.path.pose(time_ns)))
            if len(pending) >= _FRAMES_IN_FLIGHT:
                yield _finished(*pending.popleft())
        while pending:
            yield _finished(*pending.popleft())
    write_object_truth(folder / "truth/objects.json", entries)


def _finished(time_ns: int, job: Future[None]) -> int:
    job.result()
    return time_ns


def _write_frame(folder: Path, save: SaveImages, frame: FrameToWrite) -> None:
    name = f"{frame.frame.timestamp_ns}.png"
    save(frame)
    write_png(folder / "truth" / name, frame.left_id)
    write_png(folder / "truth/depth" / name, depth_image(frame.depth))


def write_png(path: Path, image: AnyArray) -> None:
    """Write a PNG, encoded in memory, so that a full disk is an error and not a short file."""
    _, data = cv2.imencode(".png", image, _PNG_FAST)
    path.write_bytes(data.tobytes())
