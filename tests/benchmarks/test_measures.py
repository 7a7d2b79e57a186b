"""What `make bench` measures with: the floor, the share outside of kernels, the tables."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

import ovmot
from bench_report import processor, table
from bench_run import RunTimes, peak_bytes, run_once
from bench_share import CallClock, counted_calls, python_share
from floor import STEPS, measure_floor, spread_corners
from ovmot.kernels.cache import compiled


def run_times(n_steady: int, begin: float, end: float) -> RunTimes:
    """A run with one stage of 2 ms; all of its CPU time in the steady state."""
    stage_ms = {"track": np.full(n_steady, 2.0)}
    return RunTimes(n_steady + 2, 0.5, begin, end, 0.8 * (end - begin), stage_ms, 200.0, 1.0, 10**8)


def test_floor_times_every_step() -> None:
    rng = np.random.default_rng(0)
    pairs = [
        (rng.integers(0, 255, (120, 160), dtype=np.uint8),) * 2 for _ in range(3)
    ]  # fmt: skip
    times = measure_floor(pairs, 50)
    assert set(times.milliseconds) == set(STEPS)
    assert all(ms > 0.0 for ms in times.milliseconds.values())
    assert times.cpu_ms > 0.0
    assert times.total_ms == pytest.approx(sum(times.milliseconds.values()) - times.repeated_ms)


def test_floor_of_images_without_corners() -> None:
    blank = np.zeros((120, 160), np.uint8)
    times = measure_floor([(blank, blank)] * 2)
    assert times.milliseconds["flow in time"] == 0.0


def test_corners_are_spread() -> None:
    """A strong cluster in one cell gives way to a weak corner in another; no corner comes twice."""
    strong = [cv2.KeyPoint(float(u), 5.0, 7.0, -1.0, 100.0 + u) for u in range(1, 9)]
    weak = [cv2.KeyPoint(95.0, 45.0, 7.0, -1.0, 1.0)]
    chosen = spread_corners([*strong, *weak], (50, 100), 4)[:, 0].tolist()
    assert chosen == [[8.0, 5.0], [95.0, 45.0], [7.0, 5.0], [6.0, 5.0]]
    assert len(spread_corners([], (50, 100), 4)) == 0


def test_calls_of_kernels_and_opencv_are_counted() -> None:
    def twice(x: float) -> float:
        return 2.0 * x

    double = compiled(twice, None)
    double(1.0)
    blur, detect = cv2.blur, cv2.FastFeatureDetector.detect
    image = np.zeros((20, 20), np.uint8)
    with counted_calls() as clock:
        assert double(2.0) == 4.0
        cv2.blur(image, (3, 3))
        cv2.FastFeatureDetector.create().detect(image)
        np.linalg.inv(np.eye(3))
    assert len(clock.calls) == 3
    assert cv2.blur is blur and cv2.FastFeatureDetector.detect is detect
    assert "__call__" not in vars(CPUDispatcher)
    assert double(3.0) == 6.0 and len(clock.calls) == 3


def test_share_outside_of_the_calls() -> None:
    """Calls that overlap, in two threads, cover their time once; those before do not count."""
    clock = CallClock([(0.0, 0.9, 0.9), (1.0, 3.0, 2.0), (2.0, 4.0, 1.0), (2.5, 2.6, 0.1)])
    share = python_share(run_times(10, 1.0, 11.0), clock)
    assert share.of_wall == pytest.approx(0.7)
    assert share.of_cpu == pytest.approx(1.0 - 3.1 / 8.0)
    assert share.calls_a_frame == pytest.approx(0.3)
    assert python_share(run_times(10, 1.0, 11.0), CallClock()).of_wall == 1.0


def test_times_of_a_run() -> None:
    run = run_times(10, 1.0, 2.0)
    assert run.wall_ms == pytest.approx(100.0)
    assert run.cpu_ms == pytest.approx(80.0)
    assert run.whole_ms == pytest.approx(1e3 * 1.5 / 12)
    assert run.frame_ms.tolist() == [2.0] * 10


def test_run_that_never_starts(painted_rig: ovmot.StereoRig) -> None:
    with pytest.raises(ovmot.OvmotError, match="never started"):
        run_once(ovmot.Odometry(painted_rig), [])


def test_peak_of_memory_is_of_now() -> None:
    assert 10**7 < peak_bytes() < 10**11


def test_table_in_markdown() -> None:
    text = table(("a", "long"), [("1", "2"), ("333", "4")])
    assert text.splitlines() == [
        "| a   | long |",
        "| --- | ---- |",
        "| 1   | 2    |",
        "| 333 | 4    |",
    ]


def test_name_of_the_processor(tmp_path: Path) -> None:
    described = tmp_path / "cpuinfo"
    described.write_text("processor : 0\nmodel name\t: Some  Processor 9000\n")
    assert processor(described) == "Some Processor 9000"
    assert processor(tmp_path / "none") != ""
