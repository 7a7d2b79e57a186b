"""Received data that waits to be processed: the only object that callbacks and worker share.

Callbacks put, the worker takes; neither blocks for long. What is dropped is decided here: whole
frames, the oldest first, so that the lag is bounded on a machine that is too slow. A frame that
waits for a silent IMU is no such lag: it is held, and what was held is worked off bit by bit.
"""

import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ovmot.ros.pairing import ImagePair, Side, StereoPairing
from ovmot.settings import LiveSettings
from ovmot.types import ImuSample

_MOST_IMU_SAMPLES = 50_000  # a minute and more, while the first frames compile
JUMP_S = 0.5
"""Stamps that go back by more than this are a restart of the source, by less are late."""
_CATCH_UP = 0.2
"""Of the frames held for the IMU, how many must be worked off with each new one: a worker a fifth
quicker than the camera loses none; a slower one loses single frames, never many in a row."""


@dataclass(frozen=True, slots=True)
class WaitingPair:
    """A pair and when it was complete, in seconds of the monotonic clock."""

    pair: ImagePair
    arrived_s: float


@dataclass(frozen=True, slots=True)
class Batch:
    """What the worker does next: first a restart, then the IMU samples, then a pair.

    `restart` says why, or is None. `waiting` counts the pairs behind this one.
    """

    restart: str | None = None
    imu: tuple[ImuSample, ...] = ()
    pair: WaitingPair | None = None
    waiting: int = 0


@dataclass(slots=True)
class _Stream:
    """The newest stamp of a stream; after a jump back, until a pair is taken, that before it."""

    last_ns: int | None = None
    before_ns: int | None = None


@dataclass(slots=True)
class _Queue:
    """Pairs in order; `held` is how many more may wait, since the IMU was silent."""

    pairs: deque[WaitingPair] = field(default_factory=deque)
    held: float = 0.0


class Intake:
    """Bounded queues of pairs and IMU samples, and the watch over jumps of their stamps.

    A pair is given out when the IMU covers it; t_imu = t_cam + `time_offset_s`.
    """

    def __init__(self, settings: LiveSettings, time_offset_s: float = 0.0) -> None:
        self._settings = settings
        self._offset_ns = round(1e9 * time_offset_s)
        self._pairing = StereoPairing(round(1e9 * settings.pair_tolerance_s))
        self._streams = {"left": _Stream(), "right": _Stream(), "imu": _Stream()}
        self._imu: deque[ImuSample] = deque(maxlen=_MOST_IMU_SAMPLES)
        self._queue = _Queue()
        self._restart: str | None = None
        self._changed = threading.Condition()
        self._counts: Counter[str] = Counter()

    def put_imu(self, sample: ImuSample) -> None:
        """Take an IMU sample; a late one is dropped."""
        with self._changed:
            self._counts["imu"] += 1
            if self._is_in_order("imu", sample.timestamp_ns):
                self._imu.append(sample)
                self._changed.notify()

    def put_image(self, side: Side, stamp_ns: int, message: Any) -> None:
        """Take an image, not decoded yet; a late one is dropped."""
        with self._changed:
            self._counts[side] += 1
            if not self._is_in_order(side, stamp_ns):
                return
            pair = self._pairing.add(side, stamp_ns, message)
            if pair is not None:
                self._counts["pairs"] += 1
                self._put_pair(WaitingPair(pair, time.monotonic()))
                self._changed.notify()

    def restart(self, why: str) -> None:
        """Drop everything that waits; the worker starts anew."""
        with self._changed:
            self._begin_again(why)
            self._changed.notify()

    def take(self, timeout_s: float) -> Batch:
        """All IMU samples and the oldest pair that they cover; an empty batch after the timeout."""
        with self._changed:
            self._changed.wait_for(self._has_work, timeout_s)
            restart, self._restart = self._restart, None
            imu = tuple(self._imu)
            self._imu.clear()
            pair = self._pop() if self._is_covered() else None
            return Batch(restart, imu, pair, len(self._queue.pairs))

    def counts(self) -> Counter[str]:
        """Messages by stream, `pairs`, and those lost: `late`, `dropped`, `unpaired`."""
        with self._changed:
            return self._counts + Counter(unpaired=self._pairing.unpaired)

    @property
    def pair_distance_s(self) -> float | None:
        """How far the stamps of the last image without a partner were from the nearest ones."""
        nearest_ns = self._pairing.nearest_ns
        return None if nearest_ns is None else 1e-9 * nearest_ns

    def _has_work(self) -> bool:
        return self._restart is not None or bool(self._imu) or self._is_covered()

    def _is_covered(self) -> bool:
        pairs = self._queue.pairs
        return bool(pairs) and self._ahead_of_imu_ns(pairs[0]) <= 0

    def _ahead_of_imu_ns(self, waiting: WaitingPair) -> float:
        """How far the IMU has still to come for this pair; infinite before its first sample."""
        newest = self._streams["imu"].last_ns
        return np.inf if newest is None else waiting.pair.timestamp_ns + self._offset_ns - newest

    def _put_pair(self, pair: WaitingPair) -> None:
        """Queue it, and drop the oldest one where the worker, not the IMU, is too slow."""
        queue, settings = self._queue, self._settings
        queue.pairs.append(pair)
        silent = sum(0 < self._ahead_of_imu_ns(p) <= 1e9 * settings.hold_s for p in queue.pairs)
        queue.held = max(queue.held - _CATCH_UP, float(silent))
        while len(queue.pairs) > settings.queue_frames + queue.held:
            queue.pairs.popleft()
            self._counts["dropped"] += 1

    def _pop(self) -> WaitingPair:
        for stream in self._streams.values():
            stream.before_ns = None  # the source runs: nothing stray is on its way any more
        return self._queue.pairs.popleft()

    def _is_in_order(self, name: str, stamp_ns: int) -> bool:
        """Note a stamp. False for a late message or a stray one; a jump begins everything again."""
        stream, jump_ns = self._streams[name], 1e9 * JUMP_S
        if stream.before_ns is not None and abs(stamp_ns - stream.before_ns) < jump_ns:
            self._counts["late"] += 1  # sent before the restart, and still on its way
            return False
        if stream.last_ns is not None and stamp_ns <= stream.last_ns:
            if stream.last_ns - stamp_ns <= jump_ns:
                self._counts["late"] += 1
                return False
            back_s = 1e-9 * (stream.last_ns - stamp_ns)
            for other in self._streams.values():
                other.before_ns = other.last_ns
            self._begin_again(f"the stamps of {name} went back by {back_s:.2f} s")
        elif name == "imu" and stream.last_ns is not None:
            hole_s = 1e-9 * (stamp_ns - stream.last_ns)
            if hole_s > self._settings.hold_s:
                self._begin_again(f"the IMU was silent for {hole_s:.2f} s")
        stream.last_ns = stamp_ns
        return True

    def _begin_again(self, why: str) -> None:
        self._counts["dropped"] += len(self._queue.pairs)
        self._pairing.clear()
        self._imu.clear()
        self._queue = _Queue()
        for stream in self._streams.values():
            stream.last_ns = None
        self._restart = why
