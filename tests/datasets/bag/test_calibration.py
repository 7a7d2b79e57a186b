"""The calibration of a bag: CameraInfo messages, a mount, a chain."""

from pathlib import Path

import numpy as np
import pytest
from bag_fixtures import (
    camera_info,
    mono,
    write_bag,
)

from ovmot.datasets.registry import open_recording
from ovmot.errors import CalibrationError
from ovmot.ros.values import Message


@pytest.mark.parametrize(("name", "version"), [("tiny.bag", 1), ("tiny", 2)])
def test_camera_info_and_a_mount_make_a_rig(
    tmp_path: Path, mount: Path, name: str, version: int
) -> None:
    cameras = {
        "/left/image_raw": mono,
        "/right/image_raw": mono,
        "/left/camera_info": camera_info(False, version),
        "/right/camera_info": camera_info(True, version),
    }
    path = write_bag(tmp_path / name, cameras)
    sequence = open_recording(path, calibration=mount)
    rig = sequence.rig
    assert rig.baseline == pytest.approx(0.3)
    assert rig.T_cam1_cam0[0, 3] == pytest.approx(-0.3)
    assert rig.time_offset_s == 0.002
    assert rig.cam0.intrinsics[:4] == pytest.approx([20.0, 21.0, 16.0, 12.0])
    with pytest.raises(CalibrationError, match=r"not where they are on the IMU.*cam0\.T_cam_imu"):
        open_recording(path)


def test_rectified_images_see_through_p(tmp_path: Path, mount: Path) -> None:
    cameras = {
        "/left/image_rect": mono,
        "/right/image_rect": mono,
        "/left/camera_info": camera_info(False),
        "/right/camera_info": camera_info(True),
    }
    rig = open_recording(write_bag(tmp_path / "t.bag", cameras), calibration=mount).rig
    assert rig.cam1.model.name == "none"
    assert rig.cam1.intrinsics[:4] == pytest.approx([20.0, 20.0, 16.0, 12.0])


def test_camera_info_without_a_baseline_or_with_an_odd_lens(tmp_path: Path, mount: Path) -> None:
    cameras = {"/l/image_raw": mono, "/r/image_raw": mono, "/l/camera_info": camera_info(False)}
    alone = write_bag(tmp_path / "alone.bag", {**cameras, "/r/camera_info": camera_info(False)})
    with pytest.raises(CalibrationError, match=r"/r/camera_info\.projection_matrix': P has no"):
        open_recording(alone, calibration=mount)
    info = camera_info(True, model="rational_polynomial")
    odd = write_bag(tmp_path / "odd.bag", {**cameras, "/r/camera_info": info})
    with pytest.raises(CalibrationError, match="unknown camera model 'rational_polynomial'"):
        open_recording(odd, calibration=mount)


def test_an_empty_camera_info_is_told(tmp_path: Path, mount: Path) -> None:
    def empty(stamp: int) -> Message:
        info = camera_info(False)(stamp)
        return Message(info.type_name, {**info.fields, "K": np.zeros(9)})

    cameras = {"/l/image_raw": mono, "/r/image_raw": mono, "/l/camera_info": empty}
    path = write_bag(tmp_path / "t.bag", cameras)
    with pytest.raises(CalibrationError, match=r"/l/camera_info: K is 0: the driver publishes an"):
        open_recording(path, calibration=mount)


def test_a_mount_without_camera_info_has_no_intrinsics(tmp_path: Path, mount: Path) -> None:
    path = write_bag(tmp_path / "t.bag", {"/left": mono, "/right": mono})
    with pytest.raises(CalibrationError) as found:
        open_recording(path, calibration=mount)
    assert str(found.value).startswith(f"{mount}: says where the left camera is, but has no intr")
    assert f"{path} has no CameraInfo beside /left and /right; give --cal" in str(found.value)


def test_without_any_calibration_both_ways_are_named(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/a/left": mono, "/a/right": mono})
    with pytest.raises(CalibrationError) as found:
        open_recording(path)
    assert "no CameraInfo beside /a/left and /a/right; give --calibration FILE: " in str(
        found.value
    )
