"""Each fault of a spoiled copy is named, and an unspoiled sequence has none."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ovmot.datasets.registry import open_sequence
from ovmot.doctor.examine import examine
from ovmot.doctor.report import Finding, Severity


def wrong_in(root: Path) -> dict[str, Finding]:
    findings = examine(open_sequence(root)).findings
    return {f.check: f for f in findings if f.severity is Severity.WRONG}


def test_an_unspoiled_sequence_is_fine(walked: Path) -> None:
    report = examine(open_sequence(walked))
    assert {f.check: f.severity for f in report.findings if f.severity is not Severity.FINE} == {}
    assert not report.is_wrong


@pytest.mark.parametrize(
    ("fault", "check", "says", "remedy"),
    [
        ("swap_sides", "left and right", "swapped", "mav0/cam0/data and mav0/cam1/data"),
        ("accel_in_g", "accelerometer unit", "1.00", "the unit is g"),
        ("gyro_in_degrees", "gyroscope unit", "0.017", "the unit is °/s"),
        ("clock_ahead", "time offset", "ahead", "timeshift_cam_imu to 0.05"),
        ("turn_right_camera", "extrinsics", "turned by 2°", "T_BS in mav0/cam1/sensor.yaml"),
        ("drop_frames", "dropped frames", "6 of 50", "copy the missing images"),
    ],
)
def test_each_fault_is_named_and_no_other(
    spoiled: Callable[[str], Path], fault: str, check: str, says: str, remedy: str
) -> None:
    wrong = wrong_in(spoiled(fault))
    assert list(wrong) == [check]
    assert says in wrong[check].says
    assert remedy in wrong[check].remedy


def test_command(
    walked: Path,
    spoiled: Callable[[str], Path],
    ovmot_command: Callable[..., Any],
    tmp_path: Path,
) -> None:
    said = ovmot_command("doctor", walked)
    assert said.code == 0, said.err
    assert "time offset" in said.out
    found = tmp_path / "found.json"
    said = ovmot_command("doctor", spoiled("accel_in_g"), "--json", found)
    assert said.code == 1
    first = json.loads(found.read_text())["findings"][0]
    assert (first["severity"], first["check"]) == ("wrong", "accelerometer unit")
    assert "the unit is g" in " ".join(said.out.split())


def test_unreadable_input_exits_with_2(ovmot_command: Callable[..., Any], tmp_path: Path) -> None:
    said = ovmot_command("doctor", tmp_path / "nowhere")
    assert said.code == 2
    assert "nowhere" in said.complaint
