"""Calibration of a date: rectified and unrectified cameras."""

from collections.abc import Callable
from pathlib import Path

import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import CalibrationError

Edit = Callable[[Path, str, str], None]


SYNC, EXTRACT = "2011_09_26_drive_0001_sync", "2011_09_26_drive_0001_extract"


def test_the_size_tells_the_form_where_the_name_does_not(kitti_raw: Path, edit: Edit) -> None:
    drive = (kitti_raw / SYNC).rename(kitti_raw / "2011_09_26_drive_0001")
    assert open_sequence(drive).rig.cam0.model.name == "none"
    edit(kitti_raw / "calib_cam_to_cam.txt", "S_rect_00: 32", "S_rect_00: 30")
    assert open_sequence(drive).rig.cam0.model.name == "radtan"
    edit(kitti_raw / "calib_cam_to_cam.txt", "S_01: 32", "S_01: 40")
    with pytest.raises(CalibrationError, match="'S_01': 40x24, but the images are 32x24"):
        open_sequence(drive)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("calib_imu_to_velo.txt", "R: 1", "R: 2", "'R': not a rotation"),
        ("calib_velo_to_cam.txt", "T: 0 ", "T: ", "'T': expected 3 numbers"),
        ("calib_cam_to_cam.txt", "P_rect_01", "P_01", "'P_rect_01': this key is missing"),
        ("calib_cam_to_cam.txt", "S_rect_00: 32", "S_rect_00: 31", "31x24, but the images"),
    ],
)
def test_broken_calibration(
    kitti_raw: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(kitti_raw / name, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        open_sequence(kitti_raw / SYNC)
    assert str(kitti_raw / name) in str(caught.value)
