"""`ovmot settings` and `ovmot config`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

import ovmot

Command = Callable[..., Any]


def test_settings_with_a_text(ovmot_command: Command) -> None:
    told = ovmot_command("settings", "FINE")
    assert told.code == 0
    keys = [line.partition(" = ")[0] for line in told.out.splitlines()]
    assert keys == ["tracker.fine_columns", "tracker.fine_features"]
    told = ovmot_command("settings", "kitti_raw")
    assert told.out.startswith("preset of kitti_raw: ")
    told = ovmot_command("settings", "lidar")
    assert told.code == 2
    assert "lidar: no setting" in told.complaint


def test_config_is_what_a_run_would_have(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    given = tmp_path / "mine.yaml"
    given.write_text("tracker: {max_features: 99, klt_levels: 4}\n")
    arguments = ("--config", given, "--set", "tracker.max_features=77")
    told = ovmot_command("config", painted_euroc, *arguments)
    assert told.code == 0
    expected = ovmot.load_settings(given, ["tracker.max_features=77"])
    assert ovmot.Settings.model_validate(yaml.safe_load(told.out)) == expected
    told = ovmot_command("config", "--changed", *arguments)
    assert yaml.safe_load(told.out) == {"tracker": {"max_features": 77, "klt_levels": 4}}
    assert ovmot_command("config", "--changed").out == ""


def test_config_with_a_preset(ovmot_command: Command) -> None:
    told = ovmot_command("config", "--format", "kitti_raw", "--changed", "--set", "imu.max_gap_s=9")
    changed = yaml.safe_load(told.out)
    assert changed["imu"]["max_gap_s"] == 9
    assert len(changed["imu"]) > 1
    told = ovmot_command("config", "--format", "rosbag")
    assert told.code == 2
    assert "unknown; known: euroc" in told.complaint
