"""A run of a spoiled copy says what is wrong in one line, with the setting that mends it."""

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.registry import open_sequence
from ovmot.datasets.sequence import RecordedSequence
from ovmot.doctor.during_run import RunCheck
from ovmot.errors import OvmotError
from ovmot.geometry import se3, so3
from ovmot.run import RunOptions, run_sequence
from ovmot.settings import Settings

WELL = Counter[str](resets=0)


def said_in_run(root: Path, out: Path) -> list[str]:
    """The lines of a run, but for those that say each second why it has not started."""
    lines: list[str] = []
    settings = Settings.model_validate({"objects": {"enabled": False}})
    with suppress(OvmotError):  # a spoiled one may never start
        run_sequence(open_sequence(root), settings, RunOptions(out), on_wait=lines.append)
    return [line for line in lines if not line.startswith("no start at")]


def test_nothing_is_said_of_an_unspoiled_sequence(walked: Path, tmp_path: Path) -> None:
    assert said_in_run(walked, tmp_path / "run") == []


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("swap_sides", "--set recording.exchange_cameras=true"),
        ("accel_in_g", "--set recording.accel_scale=9.80665"),
        ("accel_negated", "--set recording.accel_scale=-1"),
        ("gyro_in_degrees", "--set recording.gyro_scale=0.0174533"),
        ("clock_ahead", "--set recording.time_offset_s=0.3"),
    ],
)
def test_each_fault_is_one_line_with_its_remedy(
    spoiled: Callable[[str], Path], tmp_path: Path, fault: str, remedy: str
) -> None:
    root = spoiled(fault)
    lines = said_in_run(root, tmp_path / "run")
    assert len(lines) == 1
    assert remedy in lines[0]
    assert f"'ovmot doctor {root} --fix" in lines[0]
    assert "\n" not in lines[0]


def after(check: RunCheck, sequence: RecordedSequence, frame: int, started: bool) -> list[str]:
    begun = list(check.after(int(sequence.frame_ns[0]), started, WELL))
    return begun + list(check.after(int(sequence.frame_ns[frame]), started, WELL))


def test_a_long_wait_points_to_the_doctor(walked: Path) -> None:
    sequence = open_sequence(walked)
    check = RunCheck(sequence, sequence.settings())
    assert after(check, sequence, 20, started=False) == []
    (hint,) = after(check, sequence, 35, started=False)
    assert hint.endswith(f"'ovmot doctor {walked}' may say why")
    assert after(check, sequence, 40, started=False) == []


def test_a_run_that_goes_well_is_not_examined(walked: Path) -> None:
    """Not even where the pictures would show a fault."""
    sequence = open_sequence(walked)
    rig = replace(sequence.rig, time_offset_s=0.3)
    check = RunCheck(replace(sequence, rig=rig), sequence.settings())
    assert after(check, sequence, 45, started=True) == []


@pytest.mark.parametrize(
    "counts",
    [
        {"resets": 1},
        {"frames_lost": 5, "frames_degraded": 5},
        {"stereo_matches": 1000, "stereo_matches_refused": 250},
    ],
)
def test_a_run_that_is_unwell_is_examined_once(walked: Path, counts: dict[str, int]) -> None:
    sequence = open_sequence(walked)
    rig = replace(sequence.rig, time_offset_s=0.3)
    check = RunCheck(replace(sequence, rig=rig), sequence.settings())
    unwell, stamp = Counter(counts), int(sequence.frame_ns[40])
    assert after(check, sequence, 20, started=True) == []
    (line,) = check.after(stamp, True, unwell)
    assert "time offset" in line
    assert list(check.after(stamp, True, unwell)) == []


def test_what_no_setting_mends_is_said_too(walked: Path) -> None:
    """The camera on the IMU is turned: nothing but another calibration helps."""
    sequence = open_sequence(walked)
    T_imu_cam0, T_imu_cam1 = sequence.rig.T_imu_cam0, sequence.rig.T_imu_cam1
    turn = se3.make(so3.exp(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    rig = replace(sequence.rig, T_imu_cam0=turn @ T_imu_cam0, T_imu_cam1=turn @ T_imu_cam1)
    check = RunCheck(replace(sequence, rig=rig), sequence.settings(), "--calibration c.yaml")
    assert after(check, sequence, 20, started=True) == []
    unwell = Counter(frames_degraded=10)
    lines = list(check.after(int(sequence.frame_ns[-1]), True, unwell))
    assert any(line.startswith("camera on IMU: ") for line in lines)
    assert all(line.endswith(f"'ovmot doctor {walked} --calibration c.yaml' says more")
               for line in lines)  # fmt: skip


def test_frames_on_the_imu_alone_point_to_the_doctor(walked: Path) -> None:
    sequence = open_sequence(walked)
    check = RunCheck(sequence, sequence.settings())
    assert after(check, sequence, 20, started=True) == []
    stamp, unwell = int(sequence.frame_ns[40]), Counter(frames_degraded=7, frames_lost=5)
    (line,) = check.after(stamp, True, unwell)
    assert line == f"12 frames rest on the IMU alone: 'ovmot doctor {walked}' may say why"
    assert list(check.after(stamp, True, unwell)) == []


def test_a_good_share_of_refused_matches_is_not_examined(walked: Path) -> None:
    sequence = open_sequence(walked)
    rig = replace(sequence.rig, time_offset_s=0.3)
    check = RunCheck(replace(sequence, rig=rig), sequence.settings())
    assert after(check, sequence, 20, started=True) == []
    few = Counter(stereo_matches=1000, stereo_matches_refused=150)
    assert list(check.after(int(sequence.frame_ns[40]), True, few)) == []


def test_a_camera_that_hangs_upside_down_is_told_with_an_if(walked: Path) -> None:
    """The extrinsics may be right; gravity alone can not tell."""
    sequence = open_sequence(walked)
    T_imu_cam0 = sequence.rig.T_imu_cam0 @ np.diag([-1.0, -1.0, 1.0, 1.0])
    rig = replace(sequence.rig, T_imu_cam0=T_imu_cam0)
    (line,) = RunCheck(replace(sequence, rig=rig), sequence.settings()).of_imu()
    assert "if it does not" in line
