"""Faults of real rigs, put into the events of any sequence: images, IMU, clocks, the reader.

A fault is a function of events to events. `with_faults` wraps a recorded sequence, so that a run
reads the spoilt one as it reads any other. docs/faults.md says what is promised for each.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Self

import numpy as np

from ovmot.datasets.sequence import RecordedSequence, StoredPair
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.types import Event, FeatureFrame, ImuSample, StereoFrame

Frame = StereoFrame | FeatureFrame


@dataclass(frozen=True, slots=True)
class Span:
    """The time of a fault, ns of the events' stamps: from `begin_ns` until before `end_ns`."""

    begin_ns: int
    end_ns: int

    def __contains__(self, timestamp_ns: int) -> bool:
        return self.begin_ns <= timestamp_ns < self.end_ns


Fault = Callable[[Iterable[Event], Span, np.random.Generator], Iterator[Event]]


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """A fault by its name in `FAULTS`, when it happens, and the seed of what is random in it."""

    name: str
    span: Span
    seed: int = 0

    def into(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events with this fault; raises `InputError` for an unknown name."""
        if self.name not in FAULTS:
            raise InputError(f"fault {self.name}: unknown; choose one of {', '.join(FAULTS)}")
        return FAULTS[self.name](events, self.span, np.random.default_rng(self.seed))


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultySequence(RecordedSequence):
    """A recorded sequence whose events have faults; its description stays that of `inner`."""

    inner: RecordedSequence
    faults: tuple[InjectedFault, ...]

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        return self.inner.pairs(first, stop)

    def of_pairs(self) -> Self:
        return replace(self, inner=self.inner.of_pairs())

    def events(self, first: int = 0, last: int | None = None) -> Generator[Event, None, None]:
        stored = self.inner.events(first, last)
        with closing(stored):
            yield from with_injected(stored, self.faults)


def with_faults(sequence: RecordedSequence, *faults: InjectedFault) -> FaultySequence:
    """The sequence with faults put into its events, the first one first."""
    described = {each.name: getattr(sequence, each.name) for each in fields(RecordedSequence)}
    return FaultySequence(**described, inner=sequence, faults=faults)


def with_injected(events: Iterable[Event], faults: Iterable[InjectedFault]) -> Iterator[Event]:
    """Events with faults put into them, the first one first."""
    for fault in faults:
        events = fault.into(events)
    return iter(events)


# Frames


def dropped_frames(
    events: Iterable[Event], span: Span, rng: np.random.Generator
) -> Iterator[Event]:
    """Half of the frames are lost, any of them."""
    for event in events:
        if isinstance(event, ImuSample) or event.timestamp_ns not in span or rng.random() < 0.5:
            yield event


def no_frames(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """All frames are lost."""
    for event in events:
        if isinstance(event, ImuSample) or event.timestamp_ns not in span:
            yield event


def late_frames(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """Each third frame comes after its successor."""
    held: Frame | None = None
    count = 0
    for event in events:
        if isinstance(event, ImuSample):
            yield event
            continue
        if event.timestamp_ns in span and held is None:
            count += 1
            if count % 3 == 0:
                held = event
                continue
        yield event
        if held is not None:
            yield held
            held = None
    if held is not None:
        yield held


def duplicated_frames(
    events: Iterable[Event], span: Span, rng: np.random.Generator
) -> Iterator[Event]:
    """Each frame comes twice, with one stamp."""
    for event in events:
        yield event
        if not isinstance(event, ImuSample) and event.timestamp_ns in span:
            yield event


def frozen_images(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """A driver that hangs: the last images are handed out again, with new stamps."""
    last: Frame | None = None
    for event in events:
        if isinstance(event, ImuSample):
            yield event
        elif event.timestamp_ns in span and last is not None:
            yield replace(last, timestamp_ns=event.timestamp_ns)
        else:
            last = event
            yield event


def torn_images(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """The upper half of each image is that of the frame before."""
    last: StereoFrame | None = None
    for event in events:
        if isinstance(event, StereoFrame) and event.timestamp_ns in span and last is not None:
            (old_left, old_right), (left, right) = last.pair, event.pair
            torn = replace(event, left=_torn(old_left, left), right=_torn(old_right, right))
            last = event
            yield torn
        else:
            last = event if isinstance(event, StereoFrame) else last
            yield event


def _torn(before: Image, now: Image) -> Image:
    half = len(now) // 2
    return np.concatenate([before[:half], now[half:]])


def _images_changed(
    image: Callable[[Image], Image], pixels: Callable[[FloatArray], FloatArray]
) -> Fault:
    """A fault of both images of each frame; of a frame of features, of what is seen of them."""

    def fault(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
        for event in events:
            if isinstance(event, ImuSample) or event.timestamp_ns not in span:
                yield event
            elif isinstance(event, FeatureFrame):
                yield _seen(event, pixels(event.pixels))
            else:
                left, right = event.pair
                yield replace(event, left=image(left), right=image(right))

    return fault


def _seen(frame: FeatureFrame, pixels: FloatArray) -> FeatureFrame:
    """The frame with other pixels (N, 4), without the features that no camera sees."""
    kept = np.isfinite(pixels).any(axis=1)
    return FeatureFrame(frame.timestamp_ns, frame.feature_id[kept], pixels[kept])


def _exposed(gain: float) -> Callable[[Image], Image]:
    """Images of another exposure, clipped as a sensor does."""
    return lambda image: np.clip(np.round(gain * image), 0.0, 255.0).astype(np.uint8)


def _unseen(pixels: FloatArray) -> FloatArray:
    return np.full_like(pixels, np.nan)


def _as_they_are(pixels: FloatArray) -> FloatArray:
    return pixels


def left_gone(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """The left camera is gone, as by a loose cable."""
    return _without_camera("left", events, span)


def right_gone(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """The right camera is gone."""
    return _without_camera("right", events, span)


def _without_camera(side: str, events: Iterable[Event], span: Span) -> Iterator[Event]:
    for event in events:
        if isinstance(event, ImuSample) or event.timestamp_ns not in span:
            yield event
        elif isinstance(event, StereoFrame):
            left, right = event.pair
            if side == "left":
                yield replace(event, left=np.zeros_like(left), missing=(0,))
            else:
                yield replace(event, right=np.zeros_like(right), missing=(1,))
        else:
            pixels = event.pixels.copy()
            pixels[:, slice(0, 2) if side == "left" else slice(2, 4)] = np.nan
            yield _seen(event, pixels)


# IMU


def imu_gap(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """All IMU samples are lost."""
    for event in events:
        if not isinstance(event, ImuSample) or event.timestamp_ns not in span:
            yield event


def imu_spikes(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """One sample in 30 is spoilt on its way: single values, in and beyond a sensor's range."""
    for event in events:
        if isinstance(event, ImuSample) and event.timestamp_ns in span and rng.random() < 1 / 30:
            values = np.concatenate([event.gyro, event.accel])
            largest = rng.choice([1.0, 20.0]) * np.repeat([30.0, 150.0], 3)
            k = int(rng.integers(6))
            values[k] = rng.choice([-1.0, 1.0]) * largest[k]
            yield ImuSample(event.timestamp_ns, values[:3], values[3:])
        else:
            yield event


def imu_saturated(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """Shocks: for 50 ms of each 200 ms, one axis is at the end of its range, ±250 °/s or ±2 g."""
    ends = np.repeat([np.deg2rad(250.0), 2.0 * 9.81], 3)
    shock, axis, value = -1, 0, 0.0
    for event in events:
        if not isinstance(event, ImuSample) or event.timestamp_ns not in span:
            yield event
            continue
        number, since_ns = divmod(event.timestamp_ns - span.begin_ns, 200_000_000)
        if number != shock:
            shock, axis = number, int(rng.integers(6))
            value = float(rng.choice([-1.0, 1.0])) * ends[axis]
        values = np.concatenate([event.gyro, event.accel])
        values[axis] = value if since_ns < 50_000_000 else values[axis]
        yield ImuSample(event.timestamp_ns, values[:3], values[3:])


def imu_repeated(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """Each sample comes twice, with one stamp."""
    for event in events:
        yield event
        if isinstance(event, ImuSample) and event.timestamp_ns in span:
            yield event


def imu_backward(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """Each tenth sample comes after its successor."""
    held: ImuSample | None = None
    count = 0
    for event in events:
        if isinstance(event, ImuSample):
            count += event.timestamp_ns in span
            if held is None and event.timestamp_ns in span and count % 10 == 0:
                held = event
                continue
        yield event
        if held is not None and isinstance(event, ImuSample):
            yield held
            held = None
    if held is not None:
        yield held


# Clocks and the reader


def clock_jump(seconds: float) -> Fault:
    """The clock of cameras and IMU is set by so many seconds, where the span begins."""
    jump_ns = round(1e9 * seconds)

    def fault(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
        for event in events:
            stamp = event.timestamp_ns
            yield event if stamp < span.begin_ns else replace(event, timestamp_ns=stamp + jump_ns)

    return fault


def reader_fails(events: Iterable[Event], span: Span, rng: np.random.Generator) -> Iterator[Event]:
    """The sequence can not be read any further."""
    for event in events:
        if event.timestamp_ns in span:
            raise DatasetError(f"the frame at {event.timestamp_ns} ns cannot be read")
        yield event


FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "dropped_frames": dropped_frames,
        "no_frames": no_frames,
        "late_frames": late_frames,
        "duplicated_frames": duplicated_frames,
        "frozen_images": frozen_images,
        "torn_images": torn_images,
        "black_images": _images_changed(np.zeros_like, _unseen),
        "white_images": _images_changed(lambda image: np.full_like(image, 255), _unseen),
        "overexposed_images": _images_changed(_exposed(3.0), _as_they_are),
        "underexposed_images": _images_changed(_exposed(0.3), _as_they_are),
        "left_gone": left_gone,
        "right_gone": right_gone,
        "imu_gap": imu_gap,
        "imu_spikes": imu_spikes,
        "imu_saturated": imu_saturated,
        "imu_repeated": imu_repeated,
        "imu_backward": imu_backward,
        "clock_forward": clock_jump(0.5),
        "clock_back": clock_jump(-0.5),
        "clock_far_forward": clock_jump(3600.0),
        "clock_far_back": clock_jump(-3600.0),
        "reader_fails": reader_fails,
    }
)
"""The faults by name; each has a row in docs/faults.md."""
