"""The description of a recorded sequence: all that is known before an image is decoded."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Self

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import StereoListing, listed_frames
from ovmot.datasets.imu import BY_UNIT, is_near_gravity
from ovmot.datasets.instance_masks import InstanceImages
from ovmot.datasets.presets import Preset
from ovmot.datasets.stream import events
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import Image, IntArray
from ovmot.settings import RecordingSettings, Settings
from ovmot.types import Event, ImuData, ImuNoise

Decode = Callable[[Path], Image]

_LEAST_INTERVAL_NS = 500_000  # a camera of 2 kHz; microseconds of one above 2 Hz are less


@dataclass(frozen=True, slots=True)
class StoredImage:
    """An image not decoded yet: where it is, in words, and how to have it in grey."""

    where: Path | str
    decode: Callable[[], Image]


StoredPair = tuple[StoredImage | None, StoredImage | None]
"""Left and right; None where that camera gave none, and for the right one of a monocular rig."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSequence(ABC):
    """M stereo frames, or images of one camera, wherever they are stored, and the IMU beside them.

    `frame_ns` (M,) are the cameras' stamps in ns, rising; `frame_number` (M,) what the data calls
    its frames: KITTI's image numbers, else counted from 0. `missing` has the frames of one image of
    a pair: their index, counted from 0, and the camera, 0 left and 1 right, that gave none. Such a
    frame has the stamp of the image that it has. `imu` is None where the data has none
    (ego poses must then come from a file), `imu_noise` None where the data does not say it.
    `instances` are there where the data has images of what each pixel shows. `warnings` are
    sentences for the user; `counts` the numbers behind them. `preset` are the settings that this
    kind of data wants.

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
    missing: Mapping[int, int] = field(default_factory=dict)
    warnings: tuple[str, ...]
    counts: Mapping[str, int]
    instances: InstanceImages | None = None
    preset: Preset | None = None

    def __len__(self) -> int:
        return len(self.frame_ns)

    def settings(self, given: Settings | None = None) -> Settings:
        """The settings for this data: what is given, else its preset's, else the defaults."""
        chosen = given or Settings()
        return chosen if self.preset is None else self.preset.under(chosen)

    def __iter__(self) -> Iterator[Event]:
        return self.events()

    def events(self, first: int = 0, last: int | None = None) -> Generator[Event, None, None]:
        """IMU samples and frames `first` to `last` (included) as events: see `stream.events`."""
        return events(self, first=first, last=last)

    @abstractmethod
    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        """The left and right images of frames `first` to `stop - 1`, in order, one by one."""

    @abstractmethod
    def of_pairs(self) -> Self:
        """The same without the frames of which a camera's image is missing."""

    def without_mended_warnings(self, settings: RecordingSettings) -> Self:
        """The sequence, without the warning about the IMU's unit if a setting mends that."""
        imu = self.imu
        if imu is None or not self.counts.get("imu_units"):
            return self
        if not is_near_gravity(settings.accel_scale * imu.accel):
            return self
        warnings = tuple(text for text in self.warnings if BY_UNIT not in text)
        counts = {name: n for name, n in self.counts.items() if name != "imu_units"}
        return replace(self, warnings=warnings, counts=counts)

    @property
    def complete(self) -> IntArray:
        """Indices of the frames of which no image is missing."""
        return np.array([i for i in range(len(self)) if i not in self.missing], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderSequence(RecordedSequence):
    """Stereo frames in files; `decode` turns a file into a grey image. A monocular rig needs no
    right ones.

    `left_paths` and `right_paths` are the images of each camera in time order, without those that
    are `missing`. `listing` has all images that were found: also those that the IMU does not cover.
    """

    left_paths: tuple[Path, ...]
    right_paths: tuple[Path, ...]
    decode: Decode
    listing: StereoListing

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        gone_before = Counter(camera for i, camera in self.missing.items() if i < first)
        images = tuple(
            islice(paths, first - gone_before[camera], None)
            for camera, paths in enumerate((self.left_paths, self.right_paths))
        )
        for index in range(first, stop):
            gone = self.missing.get(index)
            left, right = (
                None if c == gone or c >= self.rig.n_cameras else self._stored(next(images[c]))
                for c in (0, 1)
            )
            yield left, right

    def of_pairs(self) -> Self:
        keep, pairs = self.complete, tuple(self.pairs(0, len(self)))
        left, right = (
            tuple(Path(image.where) for i in keep if (image := pairs[i][c]) is not None)
            for c in (0, 1)
        )
        return replace(
            self, frame_ns=self.frame_ns[keep], frame_number=self.frame_number[keep], missing={},
            left_paths=left, right_paths=right,
        )  # fmt: skip

    def _stored(self, path: Path) -> StoredImage:
        return StoredImage(path, partial(self.decode, path))


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
    instances: InstanceImages | None = None,
) -> FolderSequence:
    """Put a sequence together; frames that the IMU does not cover are dropped and counted.

    A single image makes a frame too, see `RecordedSequence.missing`. Raises `DatasetError` if the
    IMU covers no frame, or for stamps that are no nanoseconds.
    """
    stamps = listing.frame_ns
    if len(stamps) > 1 and np.median(np.diff(stamps)) < _LEAST_INTERVAL_NS:
        problem = f"{len(stamps)} stereo pairs within {stamps[-1] - stamps[0]} ns"
        raise DatasetError.at(root, problem, "stamps are nanoseconds: convert them")
    rig = calibration.rig
    frames = listed_frames(listing, rig.n_cameras)
    frame_ns = np.array([frame.timestamp_ns for frame in frames], dtype=np.int64)
    if imu is not None and len(stamps):
        keep = covered_frames(frame_ns, imu, rig.time_offset_s, root, findings)
        frames, frame_ns = tuple(frames[i] for i in keep), frame_ns[keep]
    numbers = [listing.numbers.get(frame.timestamp_ns, i) for i, frame in enumerate(frames)]
    gone = {i: 0 for i, frame in enumerate(frames) if frame.left is None}
    gone |= {i: 1 for i, frame in enumerate(frames) if frame.right is None}
    return FolderSequence(
        kind=kind,
        name=name,
        root=root,
        rig=rig,
        imu_noise=calibration.imu_noise,
        imu=imu,
        frame_ns=frame_ns,
        frame_number=np.array(numbers, dtype=np.int64),
        missing=gone if rig.n_cameras == 2 else {},
        left_paths=tuple(frame.left for frame in frames if frame.left is not None),
        right_paths=tuple(frame.right for frame in frames if frame.right is not None),
        decode=decode,
        listing=listing,
        warnings=(*calibration.notes, *findings.warnings),
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
