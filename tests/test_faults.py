"""The table of docs/faults.md: each row is what happens."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ovmot
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.usable_events import usable_events
from ovmot.errors import DatasetError, OvmotError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.odometry import Odometry
from ovmot.run import RunOptions, run_sequence
from ovmot.settings import ObjectSettings, Settings
from ovmot.sim.faults import FAULTS, InjectedFault, Span, with_faults, with_injected
from ovmot.sim.simulate import SimulatedSequence, simulate
from ovmot.types import Event, FrameResult, Health

PAGE = Path(__file__).parents[1] / "docs" / "faults.md"
PROMISES: dict[str, str] = dict(re.findall(r"^\| `(\w+)` \| ([\w ]+) \|", PAGE.read_text(), re.M))
NS = 1_000_000_000
BEGIN_S, WELL_AFTER_S = 4, 3
LENGTH_S = {"left_gone": 5, "right_gone": 5, "clock_back": 0, "clock_far_back": 0}
JUMP_S = {"clock_forward": 0.5, "clock_back": -0.5, "clock_far_forward": 3600.0}
COUNTED = {
    "late_frames": "frames_out_of_order",
    "duplicated_frames": "frames_out_of_order",
    "imu_spikes": "imu_spikes",
    "imu_saturated": "imu_saturated",
    "imu_repeated": "imu_out_of_order",
    "imu_backward": "imu_out_of_order",
    "clock_back": "clock_set_back",
    "clock_far_back": "clock_set_back",
    "frozen_images": "left_repeated",
    "torn_images": "right_torn",
    "black_images": "left_flat",
    "white_images": "right_flat",
    "left_gone": "left_missing",
    "right_gone": "right_missing",
}


@dataclass(frozen=True)
class Drive:
    """A street without traffic, seen by a car that drives off at 2 s and is at 9 m/s from 5 s."""

    sequence: SimulatedSequence
    events: list[Event]

    @property
    def start_ns(self) -> int:
        return int(self.sequence.frame_ns[0])

    def span(self, name: str) -> Span:
        begin_ns = self.start_ns + BEGIN_S * NS
        return Span(begin_ns, begin_ns + LENGTH_S.get(name, 1) * NS)

    def spoilt(self, name: str) -> Iterable[Event]:
        """The events from a second on, until some time after the filter is to be well again."""
        first_ns = self.start_ns + NS
        last_ns = self.span(name).end_ns + round(1e9 * (WELL_AFTER_S + 1.5))
        events = (e for e in self.events if first_ns <= e.timestamp_ns < last_ns)
        return with_injected(events, [InjectedFault(name, self.span(name), seed=1)])

    def truth(self) -> dict[int, FloatArray]:
        stamps = self.sequence.frame_ns.tolist()
        return dict(zip(stamps, self.sequence.T_world_imu, strict=True))


@pytest.fixture(scope="module")
def drive() -> Drive:
    sequence = simulate("empty", seed=1, path="drive", size=(320, 140), duration_s=12.6)
    return Drive(sequence, list(sequence))


def run(
    drive: Drive, events: Iterable[Event], *, objects: bool = False
) -> tuple[list[FrameResult], Counter[str]]:
    """What a run makes of events, and its counts."""
    settings = Settings(objects=ObjectSettings(enabled=objects))
    odometry = Odometry(drive.sequence.rig, drive.sequence.imu_noise, settings)
    counts: Counter[str] = Counter()
    results: list[FrameResult] = []
    for event in usable_events(events, counts, settings.health.lost_after_gap_s):
        results += odometry.add(event)
    results += odometry.finish()
    return results, counts + odometry.counts


def assert_well(results: list[FrameResult], drive: Drive, after_ns: int, jump_ns: int = 0) -> None:
    """From a time on: health, velocity within 0.3 m/s, motion within 5 % of the way."""
    late = [r for r in results if r.timestamp_ns >= after_ns]
    assert len(late) >= 5
    assert {r.health for r in late} == {Health.TRACKING}
    truth = drive.truth()
    T_true = np.stack([truth[r.timestamp_ns - jump_ns] for r in late])
    T = np.stack([r.T_world_imu for r in late])
    moved = se3.inverse(T[0]) @ T[-1]
    moved_true = se3.inverse(T_true[0]) @ T_true[-1]
    way = float(np.linalg.norm(moved_true[:3, 3]))
    assert np.linalg.norm(moved[:3, 3] - moved_true[:3, 3]) < 0.05 * way
    steps_s = 1e-9 * np.diff([r.timestamp_ns for r in late])
    speed_true = np.linalg.norm(np.diff(T_true[:, :3, 3], axis=0), axis=1) / steps_s
    speed = np.array([np.linalg.norm(r.velocity) for r in late])
    assert np.abs(0.5 * (speed[1:] + speed[:-1]) - speed_true).max() < 0.3


def test_the_table_has_all_faults() -> None:
    assert PROMISES.keys() == FAULTS.keys()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name for name, says in PROMISES.items() if says in ("goes on", "degraded", "resets")],
)
def test_three_seconds_after_a_fault_the_filter_is_well(name: str, drive: Drive) -> None:
    results, counts = run(drive, drive.spoilt(name))
    jump_ns = round(1e9 * JUMP_S.get(name, 0.0))
    end_ns = drive.span(name).end_ns + max(jump_ns, 0)
    assert_well(results, drive, end_ns + WELL_AFTER_S * NS, jump_ns)
    assert (results[-1].segment > 0) == (PROMISES[name] == "resets")
    if PROMISES[name] == "goes on":
        assert {r.health for r in results} == {Health.TRACKING}
    if name in COUNTED:
        assert counts[COUNTED[name]] > 0


@pytest.mark.slow
def test_after_a_clock_set_back_by_an_hour_the_rest_is_left_out(drive: Drive) -> None:
    results, counts = run(drive, drive.spoilt("clock_far_back"))
    assert results[-1].timestamp_ns < drive.span("clock_far_back").begin_ns
    assert counts["clock_set_back"] == 1
    assert counts["frames_out_of_order"] == 45
    assert {r.health for r in results} == {Health.TRACKING}


@pytest.mark.slow
def test_images_handed_out_again_make_no_object(drive: Drive) -> None:
    results, counts = run(drive, drive.spoilt("frozen_images"), objects=True)
    assert not [t for r in results for t in r.tracks if t.state == "confirmed"]
    assert counts["left_repeated"] == counts["right_repeated"] >= 8


FAST = Settings.model_validate(
    {"tracker": {"max_features": 80, "fast_threshold": 12, "equalization": "none"}}
)


def described(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "run.json").read_text())
    return found


def whole_rows(path: Path) -> int:
    """Number of rows of a csv file, all whole."""
    text = path.read_text()
    assert text.endswith("\n")
    header, *rows = text.splitlines()
    assert all(row.count(",") == header.count(",") for row in rows)
    return len(rows)


def test_what_is_left_out_is_counted_and_said(painted_euroc: Path, tmp_path: Path) -> None:
    sequence = open_sequence(painted_euroc)
    span = Span(int(sequence.frame_ns[4]), int(sequence.frame_ns[9]))
    names = ("imu_backward", "duplicated_frames")
    faulty = with_faults(sequence, *(InjectedFault(name, span) for name in names))
    run_sequence(faulty, FAST, RunOptions(tmp_path / "out"))
    told = described(tmp_path / "out")
    assert told["ended"] == "finished"
    assert told["counts"]["frames_out_of_order"] == 5
    assert told["counts"]["imu_out_of_order"] == 10
    said = {warning["message"]: warning["count"] for warning in told["warnings"]}
    assert said["frames whose stamp does not follow the one before: left out"] == 5


def test_a_reader_that_fails_stops_with_a_message(painted_euroc: Path, tmp_path: Path) -> None:
    sequence = open_sequence(painted_euroc)
    span = Span(int(sequence.frame_ns[9]), int(sequence.frame_ns[10]))
    faulty = with_faults(sequence, InjectedFault("reader_fails", span))
    with pytest.raises(DatasetError, match="cannot be read"):
        run_sequence(faulty, FAST, RunOptions(tmp_path / "out"))
    told = described(tmp_path / "out")
    assert told["ended"].startswith("failed: the frame at ")
    assert told["counts"]["frames_written"] == whole_rows(tmp_path / "out" / "state.csv") > 3


def test_on_a_full_disk_the_rows_are_whole_and_run_json_says_why(
    painted_euroc: Path, tmp_path: Path
) -> None:
    """No file may grow beyond 12 kB from the ninth frame on, as on a full disk."""
    out = tmp_path / "out"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(frame: int) -> None:
        if frame == 9:
            resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, limits[1]))

    try:
        with pytest.raises(OvmotError, match=r"points\.csv: cannot write any further"):
            run_sequence(
                open_sequence(painted_euroc), FAST, RunOptions(out, save_points=True), fill
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert re.match(r"failed: .*points\.csv: cannot write any further", described(out)["ended"])
    assert whole_rows(out / "points.csv") > 10
    assert whole_rows(out / "state.csv") > 0
    assert not (out / "run.json.part").exists()


SIGINT_BY_DEFAULT, SIGINT_IGNORED = (
    f"import signal; signal.signal(signal.SIGINT, signal.{handler}); "
    "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # also where the tests are run by nohup
    for handler in ("default_int_handler", "SIG_IGN")
)
"""What a parent leaves to its child; a shell's background job starts with the signal ignored."""
SLOW_WRITER = (
    "import time; from pathlib import Path\n"
    "from ovmot.outputs.run_writer import RunWriter; w = RunWriter.write; written = []\n"
    "def slow(self, result):\n"
    "    w(self, result); written.append(result); time.sleep(0.2)\n"
    "    while len(written) >= 5 and not Path({go!r}).exists(): time.sleep(0.05)\n"
    "RunWriter.write = slow\n"
    "import ovmot.run; ovmot.run._UPDATE_EVERY_S = 0.1\n"
    "from ovmot.cli.app import main; main()"
)
FAST_FLAGS = [
    flag
    for key in ("tracker.max_features=80", "tracker.fast_threshold=12", "tracker.equalization=none")
    for flag in ("--set", key)
]


Running = Callable[[str], subprocess.Popen[str]]


@pytest.fixture
def running(painted_euroc: Path, tmp_path: Path) -> Running:
    """Starts a run into `tmp_path / "out"` that has written three frames; it goes on slowly, and
    waits before its end for the file `tmp_path / "go"`."""

    def start(inherited: str) -> subprocess.Popen[str]:
        code, out = inherited + SLOW_WRITER.format(go=str(tmp_path / "go")), tmp_path / "out"
        command = [sys.executable, "-c", code, "run", str(painted_euroc), "-o", str(out)]
        process = subprocess.Popen([*command, *FAST_FLAGS], stderr=subprocess.PIPE, text=True)
        state, deadline = out / "state.csv", time.monotonic() + 300.0
        while time.monotonic() < deadline and process.poll() is None:
            if state.exists() and state.read_text().count("\n") >= 4:
                break
            time.sleep(0.02)
        return process

    return start


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stop", "inherited"),
    [
        (signal.SIGINT, SIGINT_BY_DEFAULT),
        (signal.SIGTERM, SIGINT_IGNORED),
        (signal.SIGHUP, SIGINT_IGNORED),
    ],
)
def test_a_signal_stops_between_two_frames(
    running: Running, tmp_path: Path, stop: signal.Signals, inherited: str
) -> None:
    process = running(inherited)
    before = described(tmp_path / "out")
    assert before["ended"] == "running"
    process.send_signal(stop)
    (tmp_path / "go").touch()
    _, err = process.communicate(timeout=120.0)
    assert (process.returncode, err.count("\n")) == (130, 1), err
    assert "interrupted; what was done until here is written whole" in err
    told = described(tmp_path / "out")
    assert told["ended"] == "interrupted"
    assert told["counts"]["frames_written"] == whole_rows(tmp_path / "out" / "state.csv") >= 3
    assert not (tmp_path / "out" / "run.json.part").exists()


@pytest.mark.slow
def test_a_killed_run_leaves_what_was_written(running: Running, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = running(SIGINT_BY_DEFAULT)
    time.sleep(0.5)
    process.kill()
    process.communicate(timeout=30.0)
    rows = whole_rows(out / "state.csv")
    told = described(out)
    assert told["ended"] == "running"
    assert 0 < told["counts"]["frames_written"] <= rows
    assert len(ovmot.Run(out).trajectory.timestamp_ns) >= rows
    os.truncate(out / "state.csv", (out / "state.csv").stat().st_size - 20)  # torn in a row
    os.truncate(out / "trajectory.tum", (out / "trajectory.tum").stat().st_size - 5)
    torn = ovmot.Run(out)
    assert len(torn.trajectory.timestamp_ns) >= rows - 1
    assert len(torn.state) == rows - 1
