"""The frames that are worked on: the front end of one beside the later stages of the one before."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from ovmot.errors import OvmotError
from ovmot.interfaces import Feedback, OdometrySource, Tracked
from ovmot.runtime import CallingThread, helping_thread
from ovmot.types import FrameResult


@dataclass(frozen=True, slots=True)
class Known:
    """What is known after a frame: the odometry source, None before there is one; the feedback for
    the front end; the oldest IMU time that may still be needed, None for all."""

    source: OdometrySource | None
    feedback: Feedback
    imu_needed_from_ns: int | None


@dataclass(frozen=True, slots=True)
class Step:
    """A frame's result, None where it has none; what went wrong, if anything; what is known now."""

    result: FrameResult | None
    error: OvmotError | None
    known: Known


class FrameJobs:
    """Two jobs a frame, each kind in order: front end, later stages.

    `threads`: 1, both are done by the caller; 2, each kind has a thread. Either way the front end
    of a frame has what was known after the frame before the last one, `known`.
    """

    def __init__(self, threads: int, before_all: Known) -> None:
        self._front, self._later = helping_thread(threads), helping_thread(threads)
        self._before_all = before_all
        self._last_two: deque[Future[Step]] = deque(maxlen=2)
        self._unreturned: deque[Future[Step]] = deque()

    def prepare(self, work: Callable[[], None]) -> None:
        """Let the thread of the later stages do some work before its first frame: it waits for the
        front end at first. With one thread, nothing is done ahead."""
        if not isinstance(self._later, CallingThread):
            self._later.submit(work)

    def known(self) -> Known:
        """What was known after the frame before the last one begun; waits for it."""
        if len(self._last_two) < 2:
            return self._before_all
        return self._last_two[0].result().known

    def begin(
        self, track: Callable[[], Tracked], later: Callable[[Callable[[], Tracked]], Step]
    ) -> None:
        """Begin a frame: `later` is given a function that waits for what `track` returns."""
        tracked = self._front.submit(track)
        step = self._later.submit(later, tracked.result)
        self._last_two.append(step)
        self._unreturned.append(step)

    def ready(self) -> list[FrameResult]:
        """Results that are there, in order; raises a frame's error in its place."""
        results: list[FrameResult] = []
        while self._unreturned and self._unreturned[0].done():
            if results and self._unreturned[0].result().error is not None:
                break  # what came before it first
            results += self._next()
        return results

    def rest(self) -> list[FrameResult]:
        """All results still awaited, in order; waits for them, and raises as `ready` does."""
        results: list[FrameResult] = []
        while self._unreturned:
            results += self._next()
        return results

    def close(self) -> None:
        """Stop the threads, once they have done what they have begun."""
        self._unreturned.clear()
        for executor in (self._front, self._later):
            executor.shutdown(wait=True, cancel_futures=True)

    def _next(self) -> list[FrameResult]:
        step = self._unreturned.popleft().result()
        if step.error is not None:
            raise step.error
        return [] if step.result is None else [step.result]
