"""What commands say while they work: bars, JSON lines, silence."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ovmot.cli.progress import HealthWatch, Style, progress, stages

Command = Callable[..., Any]
FAST = ["--set", "tracker.max_features=80", "--set", "tracker.equalization=none"]


def test_a_run_in_lines_of_json(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    told = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", "--json-lines", *FAST)
    assert told.code == 0, told.err
    lines = [json.loads(line) for line in told.out.splitlines()]
    *_, last, finished, page = lines
    assert last["event"] == "progress"
    assert (last["task"], last["done"], last["total"]) == ("run", 12, 12)
    assert last["frames_per_s"] > 0.0
    assert last["eta_s"] == 0.0
    assert last["health"] == "tracking"
    assert finished["event"] == "finished"
    assert (page["event"], page["path"]) == ("report", str(tmp_path / "out/report.html"))
    assert finished["out"] == str(tmp_path / "out")
    assert finished["frames"] == len((tmp_path / "out/state.csv").read_text().splitlines()) - 1


def test_a_quiet_run_says_nothing(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    told = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", "--quiet", *FAST)
    assert (told.code, told.out) == (0, "")
    told = ovmot_command("run", painted_euroc, "-o", tmp_path / "b", "--quiet", "--json-lines")
    assert told.code == 2
    assert "choose one of them" in told.complaint


def test_stages_are_lines_where_no_one_watches(capfd: pytest.CaptureFixture[str]) -> None:
    with stages() as advance:
        advance("render", 0, 2)
        advance("render", 1, 2)
    assert capfd.readouterr().err == "ovmot: render: 0 of 2\novmot: render: 1 of 2\n"
    with stages(Style.QUIET) as advance:
        advance("render", 1, 2)
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    with stages(Style.JSON_LINES) as advance:
        advance("render", 1, 2)
    assert json.loads(capfd.readouterr().out) == {
        "event": "progress", "task": "render", "done": 1, "total": 2,
    }  # fmt: skip


def test_json_lines_come_once_a_second_and_at_the_end(capfd: pytest.CaptureFixture[str]) -> None:
    with progress("run", 3, Style.JSON_LINES) as advance:
        for done in (1, 2, 3):
            advance(done)
    (line,) = capfd.readouterr().out.splitlines()
    assert json.loads(line)["done"] == 3


def test_an_offset_of_the_clocks_that_was_not_given_is_said() -> None:
    watch = HealthWatch(given_offset_s=0.0, offset_s=(-0.0437, 0.0005))
    told = watch.other_offset()
    assert told is not None
    assert (
        "given 0.0000 s: to start from it, run with --set recording.time_offset_s=-0.0437" in told
    )
    for found in ((0.009, 0.0005), (0.02, 0.01), (float("nan"), float("nan"))):
        assert HealthWatch(offset_s=found).other_offset() is None


def test_moving_objects_in_words() -> None:
    assert HealthWatch(objects={3}).counted_objects() == "1 moving object"
    assert HealthWatch(objects={1, 4}).counted_objects() == "2 moving objects"
