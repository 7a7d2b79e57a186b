"""One run of the odometry over events in memory: times of its frames, CPU time, memory."""

import gc
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ovmot
from ovmot.geometry.arrays import FloatArray

_CLEAR_PEAK = "5\n"
"""Written to `/proc/self/clear_refs` it sets the peak of the memory back (man 5 proc)."""


@dataclass(frozen=True, slots=True)
class RunTimes:
    """What one run took.

    The steady state begins when the first result is there, and ends with `finish`; its N frames are
    all later ones. `stage_ms`: milliseconds (N,) of each stage, in their order. `begin` and `end`
    are `time.perf_counter()` of the steady state, `cpu_s` is the CPU time of all threads in it.
    `start_s`: seconds of computing up to the first result.
    """

    n_frames: int
    start_s: float
    begin: float
    end: float
    cpu_s: float
    stage_ms: dict[str, FloatArray]
    points: float
    """Features in a frame, mean."""
    objects: float
    """Confirmed tracks in a frame, mean."""
    peak_bytes: int

    @property
    def n_steady(self) -> int:
        """Frames of the steady state."""
        return len(self.frame_ms)

    @property
    def frame_ms(self) -> FloatArray:
        """Milliseconds (N,) that all stages of a frame took."""
        return np.asarray(np.sum(list(self.stage_ms.values()), axis=0))

    @property
    def wall_ms(self) -> float:
        """Wall time a frame, ms: the frames one after the other, or overlapping."""
        return 1e3 * (self.end - self.begin) / self.n_steady

    @property
    def cpu_ms(self) -> float:
        """CPU time a frame, ms."""
        return 1e3 * self.cpu_s / self.n_steady

    @property
    def whole_ms(self) -> float:
        """Wall time a frame with the start, ms: all computing over all frames."""
        return 1e3 * (self.start_s + self.end - self.begin) / self.n_frames


def run_once(odometry: ovmot.Odometry, events: Iterable[ovmot.Event]) -> RunTimes:
    """Feed all events and time it.

    Raises `OvmotError` where fewer than two frames have a result.
    """
    gc.collect()
    _forget_peak()
    results: list[tuple[dict[str, float], int, int]] = []
    n_frames, first, begin, cpu = 0, 0, None, 0.0
    entered = time.perf_counter()
    for event in events:
        n_frames += not isinstance(event, ovmot.ImuSample)
        results += [_kept(result) for result in odometry.add(event)]
        if begin is None and results:
            first, begin, cpu = len(results), time.perf_counter(), cpu_seconds()
    cpu = cpu_seconds() - cpu
    results += [_kept(result) for result in odometry.finish()]
    end = time.perf_counter()
    steady = results[first:]
    if begin is None or not steady:
        raise ovmot.OvmotError(f"the odometry never started: {odometry.not_started_because}")
    stages = list(dict.fromkeys(name for stage_ms, *_ in steady for name in stage_ms))
    return RunTimes(
        n_frames, begin - entered, begin, end, cpu,
        {name: np.array([stage_ms.get(name, 0.0) for stage_ms, *_ in steady]) for name in stages},
        float(np.mean([n_points for _, n_points, _ in steady])),
        float(np.mean([n_objects for *_, n_objects in steady])),
        peak_bytes(),
    )  # fmt: skip


def cpu_seconds() -> float:
    """CPU time of this process and of its children, on Linux those that still run."""
    children = Path("/proc/self/task").glob("*/children")
    total, tick = time.process_time(), 1.0 / os.sysconf("SC_CLK_TCK")
    for pid in " ".join(file.read_text() for file in children).split():
        with suppress(OSError):  # it has just ended
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            total += tick * (int(fields[11]) + int(fields[12]))  # utime and stime, man proc
    return total


def _kept(result: ovmot.FrameResult) -> tuple[dict[str, float], int, int]:
    """Of a result: its times, how many features and how many confirmed tracks it has."""
    states = Counter(track.state for track in result.tracks)
    return result.milliseconds, len(result.points.feature_id), states["confirmed"]


def _forget_peak() -> None:
    """Let the peak of this process's memory be what it has now (Linux only)."""
    clear = Path("/proc/self/clear_refs")
    if clear.exists():
        clear.write_text(_CLEAR_PEAK)


def peak_bytes() -> int:
    """Greatest resident memory of this process, bytes; on Linux since `_forget_peak`."""
    status = Path("/proc/self/status")
    if status.exists():
        return 1024 * int(status.read_text().split("VmHWM:")[1].split()[0])
    unit = 1 if sys.platform == "darwin" else 1024  # man getrusage
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
