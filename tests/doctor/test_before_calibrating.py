"""`ovmot calibrate` refuses what an estimate would hide."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("swap_sides", "recording.exchange_cameras=true"),
        ("invert_right_pose", "T_BS"),
        ("permute_axes", "from where the extrinsics put it; correct T_BS"),
        ("tilt_both_cameras", "from where the extrinsics put it; correct T_BS"),
        ("gyro_in_degrees", "the unit is °/s"),
    ],
)
def test_a_mistake_of_the_rig_is_refused(
    ovmot_command: Callable[..., Any],
    spoiled: Callable[[str], Path],
    tmp_path: Path,
    fault: str,
    remedy: str,
) -> None:
    root, out = spoiled(fault), tmp_path / "chain.yaml"
    said = ovmot_command("calibrate", root, "-o", out, "--set", "objects.enabled=false")
    assert said.code == 2
    assert remedy in said.complaint
    assert "--force writes anyway" in said.complaint
    assert not out.exists()


def test_files_that_are_there_are_seen_before_the_run(
    ovmot_command: Callable[..., Any], walked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kalibr_imu_chain.yaml").write_text("")

    def not_called(*_: object) -> None:
        pytest.fail("something was run")

    monkeypatch.setattr("ovmot.run_sequence", not_called)
    said = ovmot_command("calibrate", walked, "-o", tmp_path / "chain.yaml")
    assert said.code == 2
    assert "kalibr_imu_chain.yaml: is there already" in said.complaint
