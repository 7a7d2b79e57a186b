"""How much of a run is not inside compiled kernels and OpenCV.

While `counted_calls` is in force, every call of a function compiled by numba and of OpenCV is
timed, in whatever thread it is made. What remains of the run's time is Python itself and what it
calls else: NumPy and SciPy, LAPACK among it. The timing of the calls adds to it, one or two
microseconds each, so that the shares are upper bounds.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import BuiltinFunctionType
from typing import Any

import cv2
import numpy as np
from numba.core.registry import CPUDispatcher

from bench_run import RunTimes

_METHODS = ((cv2.FastFeatureDetector, "detect"), (cv2.CLAHE, "apply"))
"""The methods of OpenCV that the package uses; everything else of it are functions."""


@dataclass(slots=True)
class CallClock:
    """Calls as rows of begin and end (`time.perf_counter()`) and CPU time of their thread, s."""

    calls: list[tuple[float, float, float]] = field(default_factory=list)

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its calls recorded."""

        def call(*arguments: Any, **named: Any) -> Any:
            cpu, begin = time.thread_time(), time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.calls.append((begin, time.perf_counter(), time.thread_time() - cpu))

        return call


@dataclass(frozen=True, slots=True)
class PythonShare:
    """Of the steady state's wall time: the share in which no thread was in a counted call. Of its
    CPU time: the share outside of them. And the number of these calls a frame."""

    of_wall: float
    of_cpu: float
    calls_a_frame: float


@contextmanager
def counted_calls() -> Iterator[CallClock]:
    """Record all calls of compiled kernels and of OpenCV in this process."""
    clock = CallClock()
    before: list[tuple[Any, str, Any]] = []
    for name, function in vars(cv2).items():
        if isinstance(function, BuiltinFunctionType):
            before.append((cv2, name, function))
    before += [(kind, name, getattr(kind, name)) for kind, name in _METHODS]
    for home, name, function in before:
        setattr(home, name, clock.timed(function))
    type.__setattr__(CPUDispatcher, "__call__", clock.timed(CPUDispatcher.__call__))
    try:
        yield clock
    finally:
        del CPUDispatcher.__call__  # what it inherits is there again
        for home, name, function in before:
            setattr(home, name, function)


def python_share(run: RunTimes, clock: CallClock) -> PythonShare:
    """What of a run's steady state was outside of the calls."""
    rows = np.array(clock.calls).reshape(-1, 3)
    rows = rows[(rows[:, 0] >= run.begin) & (rows[:, 1] <= run.end)]
    rows = rows[np.argsort(rows[:, 0])]
    reached = np.maximum.accumulate(np.concatenate([[run.begin], rows[:, 1]]))
    covered = np.maximum(rows[:, 1] - np.maximum(rows[:, 0], reached[:-1]), 0.0).sum()
    return PythonShare(
        1.0 - float(covered) / (run.end - run.begin),
        1.0 - float(rows[:, 2].sum()) / run.cpu_s,
        len(rows) / run.n_steady,
    )
