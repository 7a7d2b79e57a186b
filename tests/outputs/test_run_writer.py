from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError, OvmotError
from ovmot.outputs import run_writer
from ovmot.outputs.run_writer import OUTPUTS, RunWriter, open_outputs
from ovmot.types import FrameResult

Maker = Callable[[int], FrameResult]
ALWAYS = {"trajectory.tum", "state.csv", "covariance.csv", "tracks.csv", "timing.csv"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


class Recorder:
    """An output that remembers what happened to it, and may fail."""

    def __init__(self, failure: Exception | None = None) -> None:
        self.failure = failure
        self.closed = False
        self.stamps: list[int] = []

    def write(self, result: FrameResult) -> None:
        self.stamps.append(result.timestamp_ns)

    def close(self) -> None:
        self.closed = True
        if self.failure is not None:
            raise self.failure


def test_files_of_a_run(tmp_path: Path, rig: StereoRig, make_result: Maker) -> None:
    out = tmp_path / "deep" / "run"
    with open_outputs(out, rig=rig):
        assert names(out) == ALWAYS
    with open_outputs(
        tmp_path / "full", rig=rig, save_points=True, video=True, preview=True, calibration=True,
        frame_number={0: 0, 1: 1},
    ) as writer:  # fmt: skip
        writer.write(make_result(0))
        writer.write(make_result(1))
        assert writer.frames_written == 2
    assert names(tmp_path / "full") == set(OUTPUTS)


def test_a_failing_run_leaves_whole_rows(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    def run() -> None:
        with open_outputs(tmp_path, rig=rig, save_points=True) as writer:
            for stamp in range(3):
                writer.write(make_result(stamp))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    rows = {name: (tmp_path / name).read_text() for name in names(tmp_path)}
    assert all(text.endswith("\n") for text in rows.values())
    assert {name: text.count("\n") for name, text in rows.items()} == {
        "trajectory.tum": 3, "state.csv": 4, "covariance.csv": 4, "tracks.csv": 4,
        "timing.csv": 4, "points.csv": 13, "stereo.csv": 7,
    }  # fmt: skip


def test_full_disk_names_the_file_and_leaves_whole_rows(
    tmp_path: Path,
    rig: StereoRig,
    make_result: Maker,
    full_disk: Callable[[int], AbstractContextManager[None]],
) -> None:
    with open_outputs(tmp_path, rig=rig) as writer:
        writer.write(make_result(0))
        with full_disk(1500), pytest.raises(OvmotError, match=r"state\.csv: cannot write"):
            for stamp in range(1, 100):
                writer.write(make_result(stamp))
    lines = (tmp_path / "state.csv").read_text().split("\n")
    assert lines[-1] == ""
    assert {line.count(",") for line in lines[:-1]} == {lines[0].count(",")}


def test_a_run_is_not_overwritten_without_force(tmp_path: Path, rig: StereoRig) -> None:
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds a run already \(run.json\).*--force"):
        open_outputs(tmp_path, rig=rig)
    assert names(tmp_path) == {"run.json"}


def test_force_removes_only_files_of_a_run(tmp_path: Path, rig: StereoRig) -> None:
    for name in ("points.csv", "run.json", "report.html", "notes.txt", "my_state.csv"):
        (tmp_path / name).write_text("old")
    open_outputs(tmp_path, rig=rig, force=True).close()
    assert names(tmp_path) == ALWAYS | {"notes.txt", "my_state.csv"}
    assert (tmp_path / "notes.txt").read_text() == "old"


def test_other_files_in_the_folder_do_no_harm(tmp_path: Path, rig: StereoRig) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    open_outputs(tmp_path, rig=rig).close()
    assert names(tmp_path) == ALWAYS | {"notes.txt"}


def test_a_file_for_a_folder_is_a_clear_error(tmp_path: Path, rig: StereoRig) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match=r"out: is a file"):
        open_outputs(tmp_path / "out", rig=rig)
    with pytest.raises(InputError, match="cannot prepare the output folder"):
        open_outputs(tmp_path / "out" / "run", rig=rig)


def test_a_pose_that_is_not_finite_is_written_nowhere(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    result = make_result(17)
    bad = replace(result, ego=replace(result.ego, T_world_imu=np.full((4, 4), np.nan)))
    with open_outputs(tmp_path, rig=rig) as writer, pytest.raises(OvmotError, match="17 ns"):
        writer.write(bad)
    assert (tmp_path / "trajectory.tum").read_text() == ""


def test_all_outputs_are_closed_and_the_first_failure_is_raised() -> None:
    outputs = [Recorder(OvmotError("first")), Recorder(OvmotError("second")), Recorder()]
    with pytest.raises(OvmotError, match="first"):
        RunWriter(outputs).close()
    assert all(output.closed for output in outputs)


def test_the_error_of_the_run_goes_before_that_of_closing() -> None:
    outputs = [Recorder(OvmotError("disk full"))]
    with pytest.raises(ValueError, match="broken image") as caught, RunWriter(outputs):
        raise ValueError("broken image")
    assert caught.value.__notes__ == ["disk full"]


def test_outputs_already_open_are_closed_when_one_can_not_start(
    tmp_path: Path, rig: StereoRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Recorder()

    def fail(path: Path, context: run_writer.RunContext) -> RunWriter:
        raise InputError(f"{path}: no")

    monkeypatch.setitem(OUTPUTS, "trajectory.tum", lambda path, context: first)
    monkeypatch.setitem(OUTPUTS, "tracks.csv", fail)
    with pytest.raises(InputError, match="no"):
        open_outputs(tmp_path, rig=rig)
    assert first.closed


@pytest.mark.parametrize("force", [True, False])
def test_a_refused_output_leaves_the_folder_as_it_was(
    tmp_path: Path, rig: StereoRig, force: bool
) -> None:
    def refuse(context: run_writer.RunContext) -> Recorder:
        raise InputError("this bag is there already")

    if force:
        (tmp_path / "state.csv").write_text("an older run")
    with pytest.raises(InputError, match="this bag"):
        open_outputs(tmp_path, rig=rig, force=force, more=(refuse,))
    assert names(tmp_path) == ({"state.csv"} if force else set())


def test_two_runs_give_the_same_bytes(tmp_path: Path, rig: StereoRig, make_result: Maker) -> None:
    for name in ("a", "b"):
        with open_outputs(
            tmp_path / name, rig=rig, save_points=True, video=True, preview=True, calibration=True,
            frame_number={stamp: k for k, stamp in enumerate(range(0, 10**9, 10**8))},
        ) as writer:  # fmt: skip
            for stamp in range(0, 10**9, 10**8):
                writer.write(make_result(stamp))
    for name in OUTPUTS:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
