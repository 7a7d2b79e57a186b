"""Sequences in ROS bags: two image topics and an IMU, read as a stream."""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.datasets.bag.calibration import bag_calibration
from ovmot.datasets.bag.file import Bag, BagMessage
from ovmot.datasets.bag.images import stored_image
from ovmot.datasets.bag.topics import BagTopics, FoundTopics, find_topics
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import ReadingLimits, pair_stamps
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.sequence import RecordedSequence, StoredImage, StoredPair, covered_frames
from ovmot.datasets.text_tables import StampedTable
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import IntArray
from ovmot.types import ImuData


@dataclass(frozen=True, slots=True)
class BagSequence(RecordedSequence):
    """Stereo pairs in a bag.

    `right_ns` (M,) are the stamps of the right images, `frame_ns` those of the left ones.
    `received_ns` (M, 2): when the earlier and the later image of each pair was recorded.
    """

    bag: Path
    topics: FoundTopics
    right_ns: IntArray
    received_ns: IntArray

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        """Pairs in order; images wait in memory only while they wait for their partner."""
        order = deque(self.frame_ns[first:stop].tolist())
        left: dict[int, StoredImage] = {}
        right: dict[int, StoredImage] = {}
        waiting = {self.topics.left: left, self.topics.right: right}
        received = self.received_ns[first:stop]
        pair_of = {
            self.topics.left: {stamp: stamp for stamp in order},
            self.topics.right: dict(zip(self.right_ns[first:stop].tolist(), order, strict=True)),
        }
        begin, end = int(received[:, 0].min()), int(received[:, 1].max()) + 1
        with Bag(self.bag) as bag:
            for message in bag.messages(waiting.keys(), begin, end):
                pair_ns = pair_of[message.topic].pop(_stamp(message), None)
                if pair_ns is not None:
                    where = _where(self.bag, message)
                    waiting[message.topic][pair_ns] = stored_image(message.value, where)
                while order and order[0] in left and order[0] in right:
                    next_ns = order.popleft()
                    yield left.pop(next_ns), right.pop(next_ns)
        if order:
            problem = f"image pair {order[0]} ns is no longer there"
            raise DatasetError.at(self.bag, problem, "leave the bag alone during a run")


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
        topics = find_topics(path, bag.types, asked)
        found = bag_calibration(bag, topics, calibration, limits.need_imu_pose)
        scan = _scan(bag, topics)
    left, right = (_distinct(scan, topic, path, findings) for topic in (topics.left, topics.right))
    frame_ns, right_ns = pair_stamps(left.keys(), right.keys(), path, findings, limits)
    imu = None
    if topics.imu is not None:
        imu = _imu(path, topics.imu, scan, limits.imu_max_gap_s, findings)
    if imu is None:
        text = f"{path}: no topic of type sensor_msgs/Imu; the ego motion must come from poses"
        findings.note("no_imu", 1, text)
    else:
        offset_s = found.rig.time_offset_s
        kept = covered_frames(frame_ns, imu, offset_s, path, findings)
        frame_ns, right_ns = frame_ns[kept], right_ns[kept]
    pairs = zip(frame_ns.tolist(), right_ns.tolist(), strict=True)
    received = [sorted((left[a], right[b])) for a, b in pairs]
    return BagSequence(
        kind="bag",
        name=path.resolve().stem,
        root=path,
        rig=found.rig,
        imu_noise=found.imu_noise,
        imu=imu,
        frame_ns=frame_ns,
        frame_number=np.arange(len(frame_ns)),
        warnings=(*found.notes, *findings.warnings),
        counts=dict(findings.counts),
        bag=path,
        topics=topics,
        right_ns=right_ns,
        received_ns=np.array(received, dtype=np.int64),
    )


@dataclass(slots=True)
class _Scan:
    """Stamps and times of recording (ns) of the images by topic; the rows of the IMU."""

    images: dict[str, list[tuple[int, int]]]
    imu_ns: list[int] = field(default_factory=list)
    imu: list[tuple[float, ...]] = field(default_factory=list)


def _scan(bag: Bag, topics: FoundTopics) -> _Scan:
    """One pass over the bag; raises `DatasetError` for an image of an unknown encoding."""
    scan = _Scan({topics.left: [], topics.right: []})
    wanted = [t for t in (topics.left, topics.right, topics.imu) if t is not None]
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
