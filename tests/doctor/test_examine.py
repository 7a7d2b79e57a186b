"""Each fault of a spoiled copy is named, and an unspoiled sequence has none."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ovmot.datasets.registry import open_sequence
from ovmot.doctor.examine import examine
from ovmot.doctor.report import Finding, Severity
from ovmot.errors import DatasetError


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
        ("accel_negated", "accelerometer sign", "opposite", "mav0/imu0/data.csv by -1"),
        ("clock_ahead", "time offset", "ahead", "timeshift_cam_imu to 0.30"),
        ("lengthen_baseline", "stereo scale", "1.3", "T_BS in mav0/cam1/sensor.yaml"),
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


@pytest.mark.parametrize(
    ("fault", "fixed"),
    [
        ("swap_sides", {"exchange_cameras": True}),
        ("accel_in_g", {"accel_scale": 9.80665}),
        ("accel_negated", {"accel_scale": -1.0}),
        ("gyro_in_degrees", {"gyro_scale": np.pi / 180.0}),
        ("clock_ahead", {"time_offset_s": pytest.approx(0.3, abs=1e-3)}),
    ],
)
def test_what_is_fixed_is_fine(
    spoiled: Callable[[str], Path],
    ovmot_command: Callable[..., Any],
    tmp_path: Path,
    fault: str,
    fixed: dict[str, Any],
) -> None:
    """The settings that the doctor writes mend the data for the doctor as for a run."""
    root, out = spoiled(fault), tmp_path / "fixed.yaml"
    given = ("--set", "imu.max_gap_s=0.2")
    said = ovmot_command("doctor", root, *given, "--fix", out)
    assert said.code == 1
    assert yaml.safe_load(out.read_text()) == {"imu": {"max_gap_s": 0.2}, "recording": fixed}
    said = ovmot_command("doctor", root, "--config", out, "--fix", tmp_path / "more.yaml")
    assert said.code == 0, said.out
    assert not (tmp_path / "more.yaml").exists()
    assert ovmot_command("doctor", root, *given, "--fix", out).code == 2  # it is there


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


def test_no_imu_where_there_should_be_one(walked: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
    shutil.rmtree(root / "mav0" / "imu0")
    wrong = wrong_in(root)
    assert list(wrong) == ["IMU"]
    assert "should have an IMU" in wrong["IMU"].says
    assert "mav0/imu0/data.csv" in wrong["IMU"].remedy


def test_half_of_the_right_images(walked: Path, tmp_path: Path) -> None:
    """The pairs are examined, and what is missing is named."""
    root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
    for path in sorted((root / "mav0" / "cam1" / "data").iterdir())[20:]:
        path.unlink()
    wrong = wrong_in(root)
    assert list(wrong) == ["dropped frames"]
    assert "images without a partner: 30" in wrong["dropped frames"].says


def test_a_truncated_image_does_not_hide_the_rest(walked: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
    path = sorted((root / "mav0" / "cam1" / "data").iterdir())[7]
    path.write_bytes(path.read_bytes()[:2000])
    report = examine(open_sequence(root))
    wrong = [f for f in report.findings if f.severity is Severity.WRONG]
    assert [f.check for f in wrong] == ["images"]
    assert wrong[0].says.startswith("1 of 50 stereo pairs cannot be read: ")
    assert path.name in wrong[0].says
    whole = {f.check for f in examine(open_sequence(walked)).findings}
    assert {f.check for f in report.findings} == whole | {"images"}


def test_no_image_at_all_can_be_read(walked: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
    for path in (root / "mav0" / "cam1" / "data").iterdir():
        path.write_bytes(b"")
    with pytest.raises(DatasetError, match="the image file is empty"):
        examine(open_sequence(root))


@pytest.mark.parametrize("camera", ["cam0", "cam1"])
def test_a_camera_is_missing(
    walked: Path, tmp_path: Path, ovmot_command: Callable[..., Any], camera: str
) -> None:
    """The IMU is examined all the same."""
    root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
    shutil.rmtree(root / "mav0" / camera / "data")
    found = tmp_path / "found.json"
    said = ovmot_command("doctor", root, "--json", found)
    assert said.code == 1
    first, *rest = json.loads(found.read_text())["findings"]
    assert (first["severity"], first["check"]) == ("wrong", "cameras")
    assert {"IMU rate", "IMU gaps", "accelerometer unit"} <= {f["check"] for f in rest}
    said = ovmot_command("run", root, "-o", tmp_path / "out")
    assert said.code == 2
    assert "no such folder" in said.complaint
