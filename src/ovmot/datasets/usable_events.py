"""What a run leaves out of the events of a sequence: stamps that do not rise, spoilt IMU samples.

All that is left out is counted, and `run.json` has the counts (docs/faults.md).
"""

import math
from collections import Counter
from collections.abc import Generator, Iterable, Iterator

from ovmot.types import Event, ImuSample

_CLOCK_EVENTS = 3
"""So many events of a kind in a row from the past are no late ones: the clock was set back."""
_NARROWEST_RANGE = (math.radians(250.0),) * 3 + (2.0 * 9.81,) * 3
"""The narrowest ranges of common sensors, 250 °/s and 2 g (InvenSense MPU-6050, PS-MPU-6000A)."""
_LEAST_VARIANCE = tuple((2.0 * end / 2**16) ** 2 / 12.0 for end in _NARROWEST_RANGE)
"""That of rounding to 16 bits (B. Widrow, IRE Trans. 1956): no reading is known better."""
_SCALE_ERROR = 0.05  # how far a calibrated reading at the end of the range may be from it
_SPIKE_PROBABILITY = 0.002
_MEMORY = 100  # samples over which their scatter is averaged

Reading = tuple[float, ...]
"""Gyroscope and accelerometer of one sample: six numbers, rad/s and m/s²."""


def usable_events(
    events: Iterable[Event], counts: Counter[str], lost_after_gap_s: float
) -> Generator[Event, None, None]:
    """The events that the odometry can take, in their order; those left out go into `counts`.

    - `frames_out_of_order`, `imu_out_of_order`: the stamp does not follow the last one of its kind.
    - `clock_set_back`: how often that was so for three in a row. What the rig did meanwhile is not
      known. A gap of more than `lost_after_gap_s`, for which more is left out
      (`events_after_clock`), tells the odometry to begin anew. Twice as much is left out: the
      clocks of camera and IMU may differ by a part of it, and both must show the gap.
    - `imu_spikes`: a value that is not finite, or far above or below both its neighbours.
    - `imu_saturated`: a value that stays the same at the end of a sensor's range.
    """
    yield from _plausible(_rising(events, counts, round(2e9 * lost_after_gap_s)), counts)


def _rising(events: Iterable[Event], counts: Counter[str], gap_ns: int) -> Iterator[Event]:
    newest_ns: dict[str, int] = {}
    in_a_row: Counter[str] = Counter()
    resume_ns: int | None = None
    for event in events:
        stamp, kind = event.timestamp_ns, "imu" if isinstance(event, ImuSample) else "frames"
        if kind in newest_ns and stamp <= newest_ns[kind]:
            counts[f"{kind}_out_of_order"] += 1
            in_a_row[kind] += 1
            if in_a_row[kind] == _CLOCK_EVENTS and resume_ns is None:
                counts["clock_set_back"] += 1
                resume_ns = max(newest_ns.values()) + gap_ns
            continue
        in_a_row[kind] = 0
        if resume_ns is not None and stamp <= resume_ns:
            counts["events_after_clock"] += 1
            continue
        resume_ns = None
        newest_ns[kind] = stamp
        yield event


def _plausible(events: Iterable[Event], counts: Counter[str]) -> Iterator[Event]:
    """The events without spoilt IMU samples; each one waits for the sample behind it."""
    plausible = PlausibleImu(counts)
    waiting: list[Event] = []  # frames behind the sample that is held
    for event in events:
        if isinstance(event, ImuSample):
            usable = plausible.before(event)
            if usable is not None:
                yield usable
            if plausible.held is not event:
                continue
        else:
            waiting.append(event)
            if plausible.held is not None:
                continue
        yield from waiting
        waiting.clear()
    if plausible.held is not None:
        yield plausible.held
    yield from waiting


class PlausibleImu:
    """Tells spoilt IMU samples, one after the other, by the samples before and behind.

    Those left out go into `counts`; see `usable_events`.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._scatter = _Scatter()
        self._before: Reading | None = None  # of the sample before the one held, as it came
        self._kept: Reading | None = None  # the last usable one
        self._held: tuple[ImuSample, Reading] | None = None

    @property
    def held(self) -> ImuSample | None:
        """The newest sample, of which the next one decides."""
        return None if self._held is None else self._held[0]

    def before(self, sample: ImuSample) -> ImuSample | None:
        """The sample held so far, now that the next one is there; None where it is spoilt."""
        after = (*map(float, sample.gyro), *map(float, sample.accel))
        if not all(map(math.isfinite, after)):
            self._counts["imu_spikes"] += 1
            return None
        usable = None
        if self._held is not None:
            held, now = self._held
            if _is_saturated(now, self._before, after):
                self._counts["imu_saturated"] += 1
            elif self._kept is not None and self._scatter.is_spike(self._kept, now, after):
                self._counts["imu_spikes"] += 1
            else:
                self._kept, usable = now, held
            self._before = now
        self._held = sample, after
        return usable


def _is_saturated(now: Reading, before: Reading | None, after: Reading) -> bool:
    """Is a value the same as before or after, where a sensor's range may end?"""
    return any(
        abs(value) >= (1.0 - _SCALE_ERROR) * end
        and (value == after[k] or (before is not None and value == before[k]))
        for k, (value, end) in enumerate(zip(now, _NARROWEST_RANGE, strict=True))
    )


class _Scatter:
    """Variances of six values about the mean of their neighbours, averaged over the last ones."""

    def __init__(self) -> None:
        self._variance = list(_LEAST_VARIANCE)
        self._n_samples = 0

    def is_spike(self, before: Reading, now: Reading, after: Reading) -> bool:
        """Is a value far above both its neighbours, or far below both? It is averaged in.

        However values are distributed, fewer than p of them are farther than σ/√p from the mean of
        their neighbours (Chebyshev). A spike counts as far as it is none. The neighbour behind it
        may be one itself: of two in a row, the one up and the other down, both are.
        """
        known = self._n_samples == _MEMORY
        self._n_samples += not known
        spike = False
        for k, variance in enumerate(self._variance):
            squared = (now[k] - 0.5 * (before[k] + after[k])) ** 2
            if known and squared > variance / _SPIKE_PROBABILITY:
                rise, fall = now[k] - before[k], now[k] - after[k]
                least = min(rise * rise, fall * fall)
                spike = spike or (rise * fall > 0.0 and least > variance / _SPIKE_PROBABILITY)
                squared = variance / _SPIKE_PROBABILITY
            averaged = variance + (squared - variance) / self._n_samples
            self._variance[k] = max(averaged, _LEAST_VARIANCE[k])
        return spike
