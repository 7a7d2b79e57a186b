"""The presets that are shipped, when they are applied, and what overrules them."""

import json
import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import ovmot
from ovmot.datasets import open_recording, open_sequence
from ovmot.datasets.presets import Preset
from ovmot.datasets.registry import PRESETS
from ovmot.settings import ImuSettings, Settings

SYNC, EXTRACT = "2011_09_26_drive_0001_sync", "2011_09_26_drive_0001_extract"
FAST = ["--set", "tracker.max_features=80", "--set", "tracker.equalization=none"]

Command = Callable[..., Any]


def show_segments(root: Path) -> None:
    """What tells a VIODE folder from EuRoC's; a run does not read these images."""
    for camera in ("cam0", "cam1"):
        folder = root / "mav0" / camera / "segmentation"
        folder.mkdir(exist_ok=True)
        stamp = next((root / "mav0" / camera / "data").iterdir()).stem
        cv2.imwrite(str(folder / f"{stamp}.png"), np.zeros((24, 32, 3), dtype=np.uint8))


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS.keys())
def test_only_what_differs_and_in_the_package(preset: Preset) -> None:
    assert (files("ovmot") / "datasets" / preset.name / "preset.yaml").is_file()
    settings, default = preset.under(Settings()), Settings()
    assert preset.values
    for place in preset.values:
        section, _, key = place.partition(".")
        value = getattr(getattr(settings, section), key)
        assert value != getattr(getattr(default, section), key), place


def test_kitti_sync_has_one_and_extract_none(kitti_raw: Path) -> None:
    sync, extract = (open_sequence(kitti_raw / name) for name in (SYNC, EXTRACT))
    assert sync.settings().imu == ImuSettings(gyro_noise=3.8e-3, accel_noise=8.7e-2, max_gap_s=0.25)
    assert extract.preset is None
    assert extract.settings() == Settings()


def test_the_rate_tells_and_not_the_name(kitti_raw: Path) -> None:
    """A drive may have any name; what the preset is for is an IMU of one sample an image."""
    for name, renamed in ((SYNC, "a_drive_1"), (EXTRACT, "a_drive_2")):
        (kitti_raw / name).rename(kitti_raw / renamed)
    assert open_sequence(kitti_raw, sequence="a_drive_1").preset is not None
    assert open_sequence(kitti_raw, sequence="a_drive_2").preset is None


def test_gaps_are_those_of_the_preset_unless_one_is_given(kitti_raw: Path) -> None:
    times = kitti_raw / SYNC / "oxts" / "timestamps.txt"
    rows = times.read_text().splitlines()
    shifted = [row.replace(":25.3", ":25.35") for row in rows]  # 0.15 s after the one before
    assert shifted != rows
    times.write_text("\n".join(shifted) + "\n")
    assert "imu_gaps" not in open_sequence(kitti_raw / SYNC).counts
    assert open_recording(kitti_raw / SYNC, imu_max_gap_s=0.12).counts["imu_gaps"] == 1


def test_what_is_given_overrules(kitti_raw: Path) -> None:
    sequence = open_sequence(kitti_raw / SYNC)
    given = ovmot.load_settings(None, ["imu.gyro_noise=0.01", "objects.enabled=false"])
    settings = sequence.settings(given)
    assert (settings.imu.gyro_noise, settings.imu.accel_noise) == (0.01, 8.7e-2)
    assert not settings.objects.enabled
    assert sequence.preset is not None
    assert sequence.preset.in_force(settings) == {
        "imu.accel_noise": 8.7e-2, "imu.max_gap_s": 0.25, "calibration.rotation_sigma_rad": 1e-3,
    }  # fmt: skip
    default_given = ovmot.load_settings(None, ["imu.max_gap_s=0.1"])
    assert sequence.settings(default_given).imu.max_gap_s == 0.1


def test_noise_of_a_calibration_overrules(viode: Path) -> None:
    show_segments(viode)
    assert open_sequence(viode).settings().imu.gyro_noise == 8.7e-5
    noise = viode / "mav0" / "imu0" / "sensor.yaml"
    noise.write_text(
        "T_BS: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
        "gyroscope_noise_density: 1e-4\ngyroscope_random_walk: 1e-5\n"
        "accelerometer_noise_density: 1e-3\naccelerometer_random_walk: 1e-4\n"
    )
    for camera, x in (("cam0", 0.0), ("cam1", 0.1)):
        (viode / "mav0" / camera / "sensor.yaml").write_text(
            f"T_BS: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
            "resolution: [32, 24]\ncamera_model: pinhole\nintrinsics: [20, 20, 16, 12]\n"
            "distortion_model: none\n"
        )
    found = open_sequence(viode)
    assert found.imu_noise is not None
    assert found.settings().imu.gyro_noise is None


def test_a_run_says_its_preset(ovmot_command: Command, painted_euroc: Path, tmp_path: Path) -> None:
    show_segments(painted_euroc)
    (painted_euroc / "mav0" / "imu0" / "sensor.yaml").unlink()
    for name, more, values in (
        ("all", [], {"imu.gyro_noise": 8.7e-5, "imu.accel_noise": 2.4e-3}),
        ("one", ["--set", "imu.gyro_noise=1e-4"], {"imu.accel_noise": 2.4e-3}),
    ):
        out = tmp_path / name
        outcome = ovmot_command("run", painted_euroc, "-o", out, *FAST, *more)
        assert outcome.code == 0, outcome.err
        told = json.loads((out / "run.json").read_text())
        assert told["preset"] == {"name": "viode", "values": values}
        assert told["settings"]["imu"]["accel_noise"] == 2.4e-3
        assert told["imu_noise"]["accel"] == 2.4e-3
    shutil.rmtree(painted_euroc / "mav0" / "cam0" / "segmentation")
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "none", *FAST)
    assert json.loads((tmp_path / "none" / "run.json").read_text())["preset"] is None


def test_they_are_listed(ovmot_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    run_help = " ".join(ovmot_command("run", "--help").out.split())
    assert f"preset ({', '.join(PRESETS)}: see 'ovmot settings')" in run_help
    text = " ".join(ovmot_command("settings").out.split())
    for name, preset in PRESETS.items():
        assert f"preset of {name}: " in text
        assert all(f"{key}={value}" in text for key, value in preset.values.items())
