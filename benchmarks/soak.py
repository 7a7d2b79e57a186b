"""A long run with random faults, at the level of features and with images rendered on the fly.

    python benchmarks/soak.py                                   an hour and 20 minutes
    python benchmarks/soak.py --features 5 --rendered 2         shorter, minutes of data

Every 20 s of data have one fault of `ovmot.sim.faults`. Looked at is whether an exception comes,
the covariance is symmetric and positive definite after each frame, the filter is well 3 s after
each fault (or has been initialized anew), and memory and time per frame stay as they are.
"""

import argparse
import gc
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

import ovmot
from bench_length import circling, resident_bytes
from bench_report import table
from ovmot.datasets.usable_events import usable_events
from ovmot.frontend.given_features import GivenFeatures
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.faults import FAULTS, InjectedFault, Span
from ovmot.sim.features import FeatureRecording
from ovmot.sim.recording import record
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.sim.simulate import SimulatedSequence
from ovmot.sim.simulation import Simulation
from ovmot.types import Event, FrameResult, Health, ImuSample

PERIOD_NS = 20_000_000_000
_BEGIN_S, _SHORTEST_S, _LONGEST_S, _CAMERA_GONE_S = 5.0, 0.3, 3.0, 5.0
_WELL_AFTER_S, _LOOKED_AT_S = 3.0, 2.0
_SPEED_ERROR_MPS = 0.3
_SWING_S = 40.0  # two periods: each third of a long run has the same of all
_KNOT_S = 0.01  # of a path that vibrates
_LEAST_EIGENVALUE = -1e-9  # of correlations: a new clone is a copy of the pose, but for rounding
_FLAT = 0.05
_UNITS = 100
_JUMPS_S = {"clock_forward": 0.5, "clock_far_forward": 3600.0, "clock_back": -0.5}
_ENDING = {"reader_fails", "clock_far_back"}
_CAMERAS = {"left_gone", "right_gone"}
SOURCES = {
    "features": sorted(FAULTS.keys() - _ENDING),
    "rendered": sorted(FAULTS.keys() - _ENDING),
}
"""The faults of each source."""


@dataclass
class Soak:
    """What was noticed: per fault how often it came and how often it was not well after it; per
    20 s of data the resident memory (bytes) and the median CPU time of a frame, in units of a
    fixed computation at that time: what else runs on the machine slows both."""

    faults: Counter[str] = field(default_factory=Counter)
    not_well: Counter[str] = field(default_factory=Counter)
    counts: Counter[str] = field(default_factory=Counter)
    memory: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    n_frames: int = 0
    asymmetric: int = 0
    least_eigenvalue: float = np.inf


@dataclass(frozen=True)
class Spoilt:
    """One fault as it was put in: where it is well again, on the clock set by all faults so far."""

    name: str
    well_ns: int
    jump_ns: int


def soak(
    events: Iterable[Event],
    path: PoseSpline,
    odometry: ovmot.Odometry,
    faults: list[str],
    rng: np.random.Generator,
) -> Soak:
    """Feed the events with faults to the odometry, and look at what comes out."""
    found = Soak()
    injected: list[Spoilt] = []
    gap_s = ovmot.Settings().health.lost_after_gap_s
    stream = usable_events(_with_faults(events, faults, rng, injected), found.counts, gap_s)
    cpu_s: list[float] = []
    period, judged, spent_s, segment = 0, 0, 0.0, 0
    for event in stream:
        entered = time.process_time()
        results = odometry.add(event)
        spent_s += time.process_time() - entered
        for result in results:
            found.n_frames += 1
            cpu_s.append(spent_s)
            spent_s = 0.0
            _look_at_covariance(odometry, found)
            judged = _judge(result, injected, judged, segment, path, found)
            segment = result.segment
        if len(injected) > period:
            period = len(injected)
            gc.collect()
            if cpu_s:
                found.memory.append(float(resident_bytes()))
                found.cpu.append(float(np.median(cpu_s)) / _unit_s())
            cpu_s.clear()
    odometry.finish()
    found.faults.update(fault.name for fault in injected)
    found.counts.update({k: v for k, v in odometry.counts.items() if v})
    return found


def _unit_s() -> float:
    """CPU time of a fixed computation, s: the median of many."""
    matrix = np.random.default_rng(0).normal(size=(150, 150))
    taken: list[float] = []
    for _ in range(_UNITS):
        entered = time.process_time()
        np.linalg.eigvalsh(matrix @ matrix.T)
        taken.append(time.process_time() - entered)
    return float(np.median(taken))


def _with_faults(
    events: Iterable[Event], faults: list[str], rng: np.random.Generator, injected: list[Spoilt]
) -> Iterator[Event]:
    """The events with a fault in each period; what was put in is appended to `injected`."""
    shift_ns = 0
    for begin_ns, period in _periods(events):
        name = faults[int(rng.integers(len(faults)))]
        length_s = _CAMERA_GONE_S if name in _CAMERAS else rng.uniform(_SHORTEST_S, _LONGEST_S)
        fault_ns = begin_ns + round(1e9 * (_BEGIN_S + rng.uniform()))
        end_ns = fault_ns + round(1e9 * length_s)
        fault = InjectedFault(name, Span(fault_ns, end_ns), int(rng.integers(2**31)))
        jump_ns = round(1e9 * _JUMPS_S.get(name, 0.0))
        well_ns = (fault_ns if jump_ns else end_ns) + abs(jump_ns) + round(1e9 * _WELL_AFTER_S)
        injected.append(Spoilt(name, shift_ns + well_ns, shift_ns + jump_ns))
        for event in fault.into(period):
            yield replace(event, timestamp_ns=event.timestamp_ns + shift_ns)
        shift_ns += jump_ns


def _periods(events: Iterable[Event]) -> Iterator[tuple[int, list[Event]]]:
    """The events in lists of 20 s each, with the time at which each begins."""
    begin_ns: int | None = None
    period: list[Event] = []
    for event in events:
        if begin_ns is None:
            begin_ns = event.timestamp_ns
        if event.timestamp_ns >= begin_ns + PERIOD_NS and isinstance(event, ImuSample):
            yield begin_ns, period
            begin_ns, period = begin_ns + PERIOD_NS, []
        period.append(event)


def _look_at_covariance(odometry: ovmot.Odometry, found: Soak) -> None:
    source = odometry._source
    if source is None:
        return
    P: FloatArray = source.state.covariance  # type: ignore[attr-defined]
    found.asymmetric += not np.array_equal(P, P.T)
    sigma = np.sqrt(np.diag(P))
    known = sigma > 0.0
    correlation = (P / np.outer(sigma, sigma).clip(1e-300))[np.ix_(known, known)]
    least = float(np.linalg.eigvalsh(correlation)[0])
    found.least_eigenvalue = min(found.least_eigenvalue, least)


def _judge(
    result: FrameResult,
    injected: list[Spoilt],
    judged: int,
    segment: int,
    path: PoseSpline,
    found: Soak,
) -> int:
    """Count faults after which the filter is not well at some frame; how many are done with."""
    while judged < len(injected):
        fault = injected[judged]
        if result.timestamp_ns < fault.well_ns:
            break
        if result.timestamp_ns > fault.well_ns + round(1e9 * _LOOKED_AT_S):
            judged += 1
            continue
        velocity = path.velocity(result.timestamp_ns - fault.jump_ns)
        error = abs(float(np.linalg.norm(result.velocity)) - float(np.linalg.norm(velocity)))
        well = result.health == Health.TRACKING and error < _SPEED_ERROR_MPS
        if not well and result.segment == segment:
            found.not_well[fault.name] += 1
            judged += 1
        break
    return judged


def features_soak(minutes: float, seed: int) -> Soak:
    """A walk in circles between points at rest."""
    recording = FeatureRecording(circling(minutes), seed)
    simulation, settings = recording.simulation, ovmot.Settings()
    odometry = ovmot.Odometry(
        simulation.rig,
        simulation.imu.noise,
        settings,
        frontend=GivenFeatures(simulation.rig, settings.tracker, settings.epipolar),
    )
    rng = np.random.default_rng([seed, 1])
    return soak(recording.events(), simulation.path, odometry, SOURCES["features"], rng)


def rendered_soak(minutes: float, seed: int) -> Soak:
    """A street with traffic, driven up and down: its time goes on and back."""
    simulation = up_and_down(minutes, seed)
    sequence = SimulatedSequence(record(simulation, seed))
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise, ovmot.Settings())
    rng = np.random.default_rng([seed, 2])
    return soak(sequence, simulation.path, odometry, SOURCES["rendered"], rng)


def up_and_down(minutes: float, seed: int) -> Simulation:
    """The traffic scene with a time that swings between its 6th and its 22nd second."""
    whole = make_simulation(load_scene("traffic"), seed=seed, size=(320, 140), duration_s=25.0)
    start_ns = int(whole.camera_ns[0])
    t = np.arange(-2.0, 60.0 * minutes + 2.0, _KNOT_S)
    swung = 14.0 - 8.0 * np.cos(2.0 * np.pi * t / _SWING_S)
    stamps, then = (start_ns + np.round(1e9 * s).astype(np.int64) for s in (t, swung))

    def swinging(path: PoseSpline) -> PoseSpline:
        return PoseSpline.through(stamps, path.pose(then))

    movers = tuple(replace(mover, path=swinging(mover.path)) for mover in whole.scene.movers)
    camera_ns = start_ns + 100_000_000 * np.arange(round(600.0 * minutes), dtype=np.int64)
    return replace(
        whole,
        scene=replace(whole.scene, movers=movers),
        path=swinging(whole.path),
        camera_ns=camera_ns,
    )


def report(name: str, minutes: float, found: Soak) -> bool:
    """Print what was found; whether all of it is as it should be."""
    flat = {
        "memory": _growth(found.memory),
        "CPU time of a frame": _growth(found.cpu),
    }
    rows = [
        (fault, str(n), str(found.not_well[fault])) for fault, n in sorted(found.faults.items())
    ]
    print(f"\n## {name}: {minutes:g} min, {found.n_frames} frames with a pose\n")
    print(table(("fault", "times", "not well 3 s after it"), rows))
    print(f"\ncovariance: {found.asymmetric} times asymmetric,", end=" ")
    print(f"least eigenvalue of the correlations {found.least_eigenvalue:.1e}")
    for what, growth in flat.items():
        print(f"{what}: last third {growth:+.1%} against the first")
    print("counts:", ", ".join(f"{key} {n}" for key, n in sorted(found.counts.items())))
    return (
        not found.not_well
        and not found.asymmetric
        and found.least_eigenvalue > _LEAST_EIGENVALUE
        and all(growth < _FLAT for growth in flat.values())
    )


def _growth(values: list[float]) -> float:
    """How much the last third of the values is above the first; the first period is left out."""
    rest = values[1:]
    third = len(rest) // 3
    if third == 0:
        return 0.0
    return float(np.median(rest[-third:]) / np.median(rest[:third]) - 1.0)


def main(arguments: list[str]) -> int:
    """Run what is asked for; 1 where something is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--features", type=float, default=60.0, metavar="MINUTES")
    parser.add_argument("--rendered", type=float, default=20.0, metavar="MINUTES")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    ovmot.prepare_process()
    good = True
    for name, minutes, run in (
        ("features", asked.features, features_soak),
        ("rendered", asked.rendered, rendered_soak),
    ):
        if minutes > 0.0:
            good &= report(name, minutes, run(minutes, asked.seed))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
