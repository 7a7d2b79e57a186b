"""The description of a recorded sequence: all that is known before an image is decoded."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import StereoListing
from ovmot.datasets.instance_masks import InstanceImages
from ovmot.datasets.stream import events
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import Image, IntArray
from ovmot.types import Event, ImuData, ImuNoise

Decode = Callable[[Path], Image]

_LEAST_INTERVAL_NS = 500_000  # a camera of 2 kHz; microseconds of one above 2 Hz are less


@dataclass(frozen=True, slots=True)
class StoredImage:
    """An image not decoded yet: where it is, in words, and how to have it in grey."""

    where: Path | str
    decode: Callable[[], Image]


StoredPair = tuple[StoredImage, StoredImage]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSequence(ABC):
    """M stereo pairs, wherever they are stored, and the IMU beside them.

    `frame_ns` (M,) are the cameras' stamps in ns, rising; `frame_number` (M,) what the data calls
    its frames: KITTI's image numbers, else counted from 0. `imu` is None where the data has none
    (ego poses must then come from a file), `imu_noise` None where the data does not say it.
    `instances` are there where the data has images of what each pixel shows. `warnings` are
    sentences for the user; `counts` the numbers behind them.

    Its length is M; iterated over, it gives the events of all frames (see `stream.events`).
    """

    kind: str
    name: str
    root: Path
    rig: StereoRig
    imu_noise: ImuNoise | None
    imu: ImuData | None
    frame_ns: IntArray
    frame_number: IntArray
    warnings: tuple[str, ...]
    counts: Mapping[str, int]
    instances: InstanceImages | None = None

    def __len__(self) -> int:
        return len(self.frame_ns)

    def __iter__(self) -> Iterator[Event]:
        return self.events()

    def events(self, first: int = 0, last: int | None = None) -> Generator[Event, None, None]:
        """IMU samples and frames `first` to `last` (included) as events: see `stream.events`."""
        return events(self, first=first, last=last)

    @abstractmethod
    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        """The left and right images of frames `first` to `stop - 1`, in order, one by one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderSequence(RecordedSequence):
    """Stereo pairs in files; `decode` turns a file into a grey image."""

    left_paths: tuple[Path, ...]
    right_paths: tuple[Path, ...]
    decode: Decode

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        for index in range(first, stop):
            left, right = self.left_paths[index], self.right_paths[index]
            yield (
                StoredImage(left, partial(self.decode, left)),
                StoredImage(right, partial(self.decode, right)),
            )


def assemble(
    *,
    kind: str,
    name: str,
    root: Path,
    calibration: Calibration,
    listing: StereoListing,
    imu: ImuData | None,
    decode: Decode,
    findings: Findings,
    numbers: IntArray | None = None,
    instances: InstanceImages | None = None,
) -> FolderSequence:
    """Put a sequence together; frames that the IMU does not cover are dropped and counted.

    `numbers` (M,) are the data's own for the frames of `listing`. Raises `DatasetError` if it
    covers none of them, or for stamps that are no nanoseconds.
    """
    stamps = listing.frame_ns
    if len(stamps) > 1 and np.median(np.diff(stamps)) < _LEAST_INTERVAL_NS:
        problem = f"{len(stamps)} stereo pairs within {stamps[-1] - stamps[0]} ns"
        raise DatasetError.at(root, problem, "stamps are nanoseconds: convert them")
    keep = np.arange(len(listing.frame_ns))
    if imu is not None:
        keep = covered_frames(listing.frame_ns, imu, calibration.rig.time_offset_s, root, findings)
    return FolderSequence(
        kind=kind,
        name=name,
        root=root,
        rig=calibration.rig,
        imu_noise=calibration.imu_noise,
        imu=imu,
        frame_ns=listing.frame_ns[keep],
        frame_number=np.arange(len(keep)) if numbers is None else numbers[keep],
        left_paths=tuple(listing.left_paths[i] for i in keep),
        right_paths=tuple(listing.right_paths[i] for i in keep),
        decode=decode,
        warnings=tuple(findings.warnings),
        counts=dict(findings.counts),
        instances=instances,
    )


def covered_frames(
    frame_ns: IntArray, imu: ImuData, time_offset_s: float, root: Path, findings: Findings
) -> IntArray:
    """Indices of the frames between the first and the last IMU sample, by the IMU's clock.

    Raises `DatasetError` if there are none; the others are counted.
    """
    at = frame_ns + round(time_offset_s * 1e9)
    first, last = imu.timestamp_ns[0], imu.timestamp_ns[-1]
    keep = np.flatnonzero((at >= first) & (at <= last))
    if len(keep) == 0:
        spans = [ns_to_seconds(int(t)) for t in (at[0], at[-1], first, last)]
        moved = f", moved by the time offset of {time_offset_s:g} s" if time_offset_s else ""
        problem = (
            f"images ({spans[0]} ... {spans[1]} s{moved}) and IMU ({spans[2]} ... {spans[3]} s)"
            " do not overlap"
        )
        raise DatasetError.at(root, problem, "stamps are nanoseconds of one clock; check both")
    lost = len(frame_ns) - len(keep)
    text = f"{root}: {lost} frames before the first or after the last IMU sample: dropped"
    findings.note("frames_outside_imu", lost, text)
    return keep
