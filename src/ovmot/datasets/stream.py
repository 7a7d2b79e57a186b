"""A sequence as events in time order, its images decoded ahead in worker threads."""

from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import Image
from ovmot.types import Event, ImuData, ImuSample, StereoFrame

if TYPE_CHECKING:  # which is iterated over by `events`
    from ovmot.datasets.sequence import RecordedSequence, StoredImage

AHEAD = 8
"""Stereo pairs decoded or being decoded at most, before they are asked for."""

_LEAD_S = 5.0
_TAIL_S = 1.0


def events(
    sequence: "RecordedSequence", *, first: int = 0, last: int | None = None
) -> Generator[Event, None, None]:
    """IMU samples and stereo frames `first` ... `last` (both included, counted from 0), merged.

    A frame comes after all IMU samples with a stamp up to its own. IMU samples begin at most 5 s
    before the first frame and go on to 1 s after the last one. Closing the generator ends the
    workers. Raises `DatasetError` at the frame whose image is broken or has a wrong size.
    """
    stop = len(sequence) if last is None else min(last + 1, len(sequence))
    if not 0 <= first < stop:
        raise DatasetError.at(
            sequence.root,
            f"no frames {first} to {stop - 1 if last is None else last}",
            f"the sequence has frames 0 to {len(sequence) - 1}",
        )
    return _merged(sequence, first, stop)


def _merged(sequence: "RecordedSequence", first: int, stop: int) -> Generator[Event, None, None]:
    imu, frame_ns = sequence.imu, sequence.frame_ns
    position, end = (0, 0) if imu is None else _imu_range(sequence, imu, first, stop)
    for index, (left, right) in enumerate(_decoded_pairs(sequence, first, stop), start=first):
        stamp = int(frame_ns[index])
        if imu is not None:
            until = int(np.searchsorted(imu.timestamp_ns, stamp, side="right"))
            yield from samples(imu, position, min(until, end))
            position = max(position, until)
        yield StereoFrame(stamp, left, right)
    if imu is not None:
        yield from samples(imu, position, end)


def _imu_range(
    sequence: "RecordedSequence", imu: ImuData, first: int, stop: int
) -> tuple[int, int]:
    offset_s = sequence.rig.time_offset_s
    begin = int(sequence.frame_ns[first]) - round(1e9 * (_LEAD_S + max(0.0, -offset_s)))
    finish = int(sequence.frame_ns[stop - 1]) + round(1e9 * (_TAIL_S + max(0.0, offset_s)))
    low = np.searchsorted(imu.timestamp_ns, begin)
    high = np.searchsorted(imu.timestamp_ns, finish, side="right")
    return int(low), int(high)


def samples(imu: ImuData, begin: int, end: int) -> Iterator[ImuSample]:
    """The samples `begin` to `end` - 1, one by one."""
    for i in range(begin, end):
        yield ImuSample(int(imu.timestamp_ns[i]), imu.gyro[i], imu.accel[i])


def _decoded_pairs(
    sequence: "RecordedSequence", first: int, stop: int
) -> Generator[tuple[Image, Image], None, None]:
    """Pairs in order, both sides decoded in parallel, at most `AHEAD` pairs in memory."""
    pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="ovmot-decode")
    waiting: deque[tuple[Future[Image], Future[Image]]] = deque()
    rig, stored = sequence.rig, sequence.pairs(first, stop)

    def order(count: int) -> None:
        for left, right in islice(stored, count):
            jobs = pool.submit(_image, left, rig.cam0), pool.submit(_image, right, rig.cam1)
            waiting.append(jobs)

    try:
        order(AHEAD)
        while waiting:
            left, right = waiting.popleft()
            pair = left.result(), right.result()
            order(1)
            yield pair
    finally:
        stored.close()
        pool.shutdown(wait=True, cancel_futures=True)


def _image(stored: "StoredImage", camera: Camera) -> Image:
    image = stored.decode()
    height, width = image.shape
    if (width, height) != (camera.width, camera.height):
        exchanged = (height, width) == (camera.width, camera.height)
        raise DatasetError.at(
            stored.where,
            f"the image is {width}x{height} pixels, its camera {camera.width}x{camera.height}",
            "exchange width and height in the calibration"
            if exchanged
            else "give the calibration that belongs to these images",
        )
    return image
