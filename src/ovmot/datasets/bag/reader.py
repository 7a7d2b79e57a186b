"""Sequences in ROS bags: two image topics and an IMU, read as a stream."""

from collections import deque
from collections.abc import Collection, Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from ovmot.datasets.bag.calibration import (
    bag_calibration,
    given_calibration,
    topics_of_cameras,
)
from ovmot.datasets.bag.file import Bag, BagMessage
from ovmot.datasets.bag.images import stored_image
from ovmot.datasets.bag.topics import BagTopics, FoundTopics, find_topics, without_imu
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import ReadingLimits, pair_stamps
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.sequence import RecordedSequence, StoredImage, StoredPair, covered_frames
from ovmot.datasets.text_tables import StampedTable
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import IntArray
from ovmot.types import ImuData


@dataclass(frozen=True, slots=True)
class BagSequence(RecordedSequence):
    """Stereo frames in a bag, or the images of its one camera.

    `right_ns` (M,) are the stamps of the right images, `frame_ns` those of the left ones, and of
    the one camera; where one of them is `missing`, both are the other's.
    `received_ns` (M, 2): when the earlier and the later image of each frame was recorded.
    """

    bag: Path
    topics: FoundTopics
    right_ns: IntArray
    received_ns: IntArray

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        """Pairs in order; images wait in memory only while they wait for their partner."""
        if self.topics.right is None:
            yield from self._singles(first, stop)
            return
        order = deque(range(first, stop))
        waiting: dict[str, dict[int, StoredImage]] = {topic: {} for topic in self.topics.images}
        received = self.received_ns[first:stop]
        frame_of = {
            topic: {int(stamps[i]): i for i in order if self.missing.get(i) != camera}
            for camera, (topic, stamps) in enumerate(
                zip(self.topics.images, (self.frame_ns, self.right_ns), strict=True)
            )
        }
        begin, end = int(received[:, 0].min()), int(received[:, 1].max()) + 1
        with Bag(self.bag) as bag:
            for message in bag.messages(waiting.keys(), begin, end):
                index = frame_of[message.topic].pop(_stamp(message), None)
                if index is not None:
                    where = _where(self.bag, message)
                    waiting[message.topic][index] = stored_image(message.value, where)
                while order:
                    pair = tuple(images.get(order[0]) for images in waiting.values())
                    if pair.count(None) > (order[0] in self.missing):
                        break
                    yield pair[0], pair[1]
                    index = order.popleft()
                    for images in waiting.values():
                        images.pop(index, None)
        if order:
            raise _gone(self.bag, f"image pair {self.frame_ns[order[0]]} ns")

    def of_pairs(self) -> Self:
        keep = self.complete
        return replace(
            self, frame_ns=self.frame_ns[keep], frame_number=self.frame_number[keep], missing={},
            right_ns=self.right_ns[keep], received_ns=self.received_ns[keep],
        )  # fmt: skip

    def _singles(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        """The images of the one camera, in order of their stamps."""
        order, received = deque(self.frame_ns[first:stop].tolist()), self.received_ns[first:stop]
        waiting: dict[int, StoredImage] = {}
        wanted = set(order)
        with Bag(self.bag) as bag:
            begin, end = int(received.min()), int(received.max()) + 1
            for message in bag.messages([self.topics.left], begin, end):
                stamp = _stamp(message)
                if stamp in wanted:
                    wanted.remove(stamp)
                    waiting[stamp] = stored_image(message.value, _where(self.bag, message))
                while order and order[0] in waiting:
                    yield waiting.pop(order.popleft()), None
        if order:
            raise _gone(self.bag, f"image {order[0]} ns")


def _gone(path: Path, what: str) -> InputError:
    return DatasetError.at(path, f"{what} is no longer there", "leave the bag alone during a run")


def read_bag(
    path: Path, asked: BagTopics, calibration: Path | Calibration | None, limits: ReadingLimits
) -> BagSequence:
    """Describe the sequence in a bag; no image is decoded or kept.

    The bag is read through once for its stamps and its IMU: those of the headers count, not when
    a message was recorded. `calibration` is a Kalibr chain (see `bag_calibration`). Raises
    `InputError` and its children for what is wrong.
    """
    findings = Findings()
    with Bag(path) as bag:
        given = given_calibration(calibration, asked, limits.need_imu_pose)
        asked = topics_of_cameras(bag, given, asked)
        n_cameras = given.rig.n_cameras if isinstance(given, Calibration) else 2
        topics = find_topics(path, bag.types, asked, n_cameras)
        found = bag_calibration(bag, topics, given)
        scan = _scan(bag, topics)
    if topics.right is None:
        findings.note("one_camera", 1, f"{path}: one camera, {topics.left}")
    seen = [_distinct(scan, topic, path, findings) for topic in topics.images]
    left, right = seen[0], seen[-1]
    pairs_ns = pair_stamps(left.keys(), right.keys(), path, findings, limits)
    frame_ns, right_ns, gone = _with_single_images(left.keys(), right.keys(), *pairs_ns)
    imu = None
    if topics.imu is not None:
        imu = _imu(path, topics.imu, scan, limits.imu_max_gap_s, findings)
    if imu is None:
        findings.note("no_imu", 1, f"{path}: {without_imu(bag.types)}")
    else:
        offset_s = found.rig.time_offset_s
        kept = covered_frames(frame_ns, imu, offset_s, path, findings)
        frame_ns, right_ns, gone = frame_ns[kept], right_ns[kept], gone[kept]
    received = [
        sorted((right[r] if camera == 0 else left[f], left[f] if camera == 1 else right[r]))
        for f, r, camera in zip(frame_ns.tolist(), right_ns.tolist(), gone.tolist(), strict=True)
    ]
    return BagSequence(
        kind="bag",
        name=path.resolve().stem,
        root=path,
        rig=found.rig,
        imu_noise=found.imu_noise,
        imu=imu,
        frame_ns=frame_ns,
        frame_number=np.arange(len(frame_ns)),
        missing={i: camera for i, camera in enumerate(gone.tolist()) if camera >= 0},
        warnings=(*found.notes, *findings.warnings),
        counts=dict(findings.counts),
        bag=path,
        topics=topics,
        right_ns=right_ns,
        received_ns=np.array(received, dtype=np.int64),
    )


def _with_single_images(
    left: Collection[int], right: Collection[int], left_ns: IntArray, right_ns: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """All frames in time order: stamps left and right (M,), and which camera is missing (M,).

    `left_ns`, `right_ns` are the pairs (K,). No camera is missing where it is -1; a single image's
    stamp stands for both.
    """
    pairs = [(a, b, -1) for a, b in zip(left_ns.tolist(), right_ns.tolist(), strict=True)]
    no_right = [(a, a, 1) for a in set(left) - set(left_ns.tolist())]
    no_left = [(b, b, 0) for b in set(right) - set(right_ns.tolist())]
    frames = np.array(sorted([*pairs, *no_right, *no_left]), dtype=np.int64).reshape(-1, 3)
    return frames[:, 0], frames[:, 1], frames[:, 2]


@dataclass(slots=True)
class _Scan:
    """Stamps and times of recording (ns) of the images by topic; the rows of the IMU."""

    images: dict[str, list[tuple[int, int]]]
    imu_ns: list[int] = field(default_factory=list)
    imu: list[tuple[float, ...]] = field(default_factory=list)


def _scan(bag: Bag, topics: FoundTopics) -> _Scan:
    """One pass over the bag; raises `DatasetError` for an image of an unknown encoding."""
    scan = _Scan({topic: [] for topic in topics.images})
    wanted = [*topics.images, *([] if topics.imu is None else [topics.imu])]
    for message in bag.messages(wanted):
        if message.topic == topics.imu:
            gyro, accel = message.value.angular_velocity, message.value.linear_acceleration
            scan.imu_ns.append(_stamp(message))
            scan.imu.append((gyro.x, gyro.y, gyro.z, accel.x, accel.y, accel.z))
        else:
            stored_image(message.value, _where(bag.path, message))
            scan.images[message.topic].append((_stamp(message), message.received_ns))
    for topic in wanted:
        read = len(scan.imu) if topic == topics.imu else len(scan.images[topic])
        if read < bag.counts[topic]:
            raise bag.unreadable(f"{read} of {bag.counts[topic]} messages of {topic}")
    return scan


def _distinct(scan: _Scan, topic: str, path: Path, findings: Findings) -> dict[int, int]:
    """Stamp -> time of recording of a camera's images, equal stamps once."""
    images = scan.images[topic]
    if not images:
        raise DatasetError.at(path, f"topic {topic} holds no images", "record it again")
    if all(stamp == 0 for stamp, _ in images):
        problem = f"topic {topic}: the headers hold no stamps"
        raise DatasetError.at(path, problem, "the driver must stamp its images")
    found: dict[int, int] = {}
    for stamp, received_ns in images:
        found.setdefault(stamp, received_ns)
    doubles = len(images) - len(found)
    text = f"{path}, topic {topic}: {doubles} images with a stamp that was there before: dropped"
    findings.note("duplicate_frames", doubles, text)
    return found


def _imu(path: Path, topic: str, scan: _Scan, max_gap_s: float, findings: Findings) -> ImuData:
    """The samples in the order of their stamps: messages may overtake each other on their way."""
    place = f"{path}, topic {topic}"
    if not scan.imu:
        raise DatasetError.at(path, f"topic {topic} holds no messages", "choose with --imu TOPIC")
    stamps = np.array(scan.imu_ns, dtype=np.int64)
    late = int(np.count_nonzero(np.diff(stamps) < 0))
    text = f"{place}: {late} IMU messages were recorded after a later one: put in order"
    findings.note("imu_out_of_order", late, text)
    order = np.argsort(stamps, kind="stable")
    table = StampedTable(place, stamps[order], np.array(scan.imu)[order], order + 1)
    return checked_imu(table, 0, 3, max_gap_s, findings)


def _stamp(message: BagMessage) -> int:
    stamp: Any = message.value.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _where(path: Path, message: BagMessage) -> str:
    return f"{path}, topic {message.topic}, image {_stamp(message)} ns"
