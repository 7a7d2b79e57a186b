"""Runs of the odometry and the floor's loop in turn, on one sequence in memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import ovmot
from bench_inputs import Recording
from bench_run import RunTimes, run_once
from bench_share import PythonShare, counted_calls, python_share
from floor import measure_floor
from ovmot.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Turns:
    """R runs of the odometry with the same settings; `floor_ms`, `floor_cpu_ms` (R,): wall and CPU
    time of the floor, the mean of its loops before and after each run."""

    runs: tuple[RunTimes, ...]
    floor_ms: FloatArray
    floor_cpu_ms: FloatArray
    share: PythonShare | None = None

    @property
    def ratios(self) -> FloatArray:
        """Wall time a frame in the steady state as a multiple of the floor, of each run (R,)."""
        return np.array([run.wall_ms for run in self.runs]) / self.floor_ms

    @property
    def whole_ratios(self) -> FloatArray:
        """The same with the start (R,)."""
        return np.array([run.whole_ms for run in self.runs]) / self.floor_ms

    @property
    def cpu_ratios(self) -> FloatArray:
        """CPU time a frame in the steady state as a multiple of the floor's (R,)."""
        return np.array([run.cpu_ms for run in self.runs]) / self.floor_cpu_ms

    @property
    def stage_ms(self) -> dict[str, FloatArray]:
        """Milliseconds (N,) of each stage in each frame, the median over the runs."""
        return {
            name: _median_of([run.stage_ms[name] for run in self.runs])
            for name in self.runs[0].stage_ms
        }

    @property
    def frame_ms(self) -> FloatArray:
        """Milliseconds (N,) of all stages of each frame, the median over the runs."""
        return _median_of([run.frame_ms for run in self.runs])

    def median(self, name: str) -> float:
        """The median over the runs of one of their figures."""
        return float(np.median([getattr(run, name) for run in self.runs]))


def _median_of(runs: Sequence[FloatArray]) -> FloatArray:
    """The median (N,) over runs, frame by frame; of some, the first results came two at once, and
    the steady state begins a frame later."""
    n = min(len(values) for values in runs)
    return np.asarray(np.median([values[-n:] for values in runs], axis=0))


def take_turns(
    recording: Recording,
    variants: Mapping[str, ovmot.Settings],
    runs: int,
    *,
    with_share: bool = False,
    threads: int = 2,
) -> dict[str, Turns]:
    """The floor's loop and a run of each of the `variants` in turn, `runs` times.

    One run of the first variant comes before them, so that all that is compiled or loaded at the
    first use is there. `with_share`: one more run of each variant, in one
    thread, with its calls counted. `threads`: of the odometry. Raises
    `OvmotError` where the odometry does not start.
    """
    _run(recording, next(iter(variants.values())), threads)
    pairs = recording.pairs
    floors = [measure_floor(pairs)]
    found: dict[str, list[tuple[RunTimes, float, float]]] = {name: [] for name in variants}
    for _ in range(runs):
        for name, settings in variants.items():
            run = _run(recording, settings, threads)
            floors.append(measure_floor(pairs))
            before, after = floors[-2:]
            wall = 0.5 * (before.total_ms + after.total_ms)
            found[name].append((run, wall, 0.5 * (before.cpu_ms + after.cpu_ms)))
    return {
        name: Turns(
            tuple(run for run, *_ in found[name]),
            np.array([wall for _, wall, _ in found[name]]),
            np.array([cpu for *_, cpu in found[name]]),
            _share(recording, settings) if with_share else None,
        )
        for name, settings in variants.items()
    }


def _run(recording: Recording, settings: ovmot.Settings, threads: int) -> RunTimes:
    odometry = ovmot.Odometry(recording.rig, recording.imu_noise, settings, threads=threads)
    return run_once(odometry, recording.events)


def _share(recording: Recording, settings: ovmot.Settings) -> PythonShare:
    with counted_calls() as clock:
        run = _run(recording, settings, 1)
    return python_share(run, clock)
