"""Any format's calibration as a Kalibr chain, which `--calibration` reads back."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from bag_fixtures import chain, imu, mono, write_bag

from ovmot.cameras.rig import StereoRig
from ovmot.datasets import open_recording, open_sequence
from ovmot.datasets.calibration_export import write_calibration
from ovmot.errors import InputError

__all__ = ["chain"]

SYNC, EXTRACT = "2011_09_26_drive_0001_sync", "2011_09_26_drive_0001_extract"
FORMATS = (
    "euroc", "kaist", "kitti_tracking", "kitti_odometry", "kitti_raw", "tum_vi", "viode", "uzh_fpv",
    "four_seasons",
)  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_comes_back(
    name: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    assert_same_rig: Callable[[StereoRig, StereoRig], None],
) -> None:
    folder: Path = request.getfixturevalue(name)
    for segments in folder.glob("mav0/*/segmentation"):
        cv2.imwrite(str(segments / "1403636580000000555.png"), np.zeros((24, 32, 3), np.uint8))
    sequence = open_sequence(folder, sequence=EXTRACT if name == "kitti_raw" else None)
    out = tmp_path / "out" / "chain.yaml"
    written = write_calibration(sequence, out)
    read = open_sequence(folder, sequence=EXTRACT if name == "kitti_raw" else None, calibration=out)
    assert_same_rig(read.rig, sequence.rig)
    assert read.rig.time_offset_s == sequence.rig.time_offset_s
    assert read.imu_noise == sequence.imu_noise
    assert len(written.files) == (1 if sequence.imu_noise is None else 2)
    skewed = any(camera.intrinsics[4] for camera in sequence.rig.cameras)
    assert skewed == any("skew" in note for note in written.notes) == (name == "kaist")


def test_one_camera_is_written_alone(euroc: Path, tmp_path: Path) -> None:
    shutil.rmtree(euroc / "mav0" / "cam1")
    sequence, out = open_sequence(euroc), tmp_path / "chain.yaml"
    write_calibration(sequence, out)
    assert set(yaml.safe_load(out.read_text())) == {"cam0"}
    read = open_sequence(euroc, calibration=out).rig
    assert read.n_cameras == 1
    np.testing.assert_allclose(read.T_imu_cam0, sequence.rig.T_imu_cam0, atol=1e-12)


def test_what_is_there_is_kept(euroc: Path, tmp_path: Path) -> None:
    sequence = open_sequence(euroc)
    out = tmp_path / "chain.yaml"
    write_calibration(sequence, out)
    with pytest.raises(InputError, match=r"chain\.yaml: is there already; .*--force"):
        write_calibration(sequence, out)
    out.unlink()
    with pytest.raises(InputError, match=r"kalibr_imu_chain\.yaml: is there already"):
        write_calibration(sequence, out)
    assert not out.exists()
    assert write_calibration(sequence, out, replace=True).files[0] == out


def test_the_imu_file_is_that_of_openvins(euroc: Path, tmp_path: Path) -> None:
    imu_file = write_calibration(open_sequence(euroc), tmp_path / "chain.yaml").files[1]
    assert imu_file.name == "kalibr_imu_chain.yaml"
    imu0 = yaml.safe_load(imu_file.read_text())["imu0"]
    np.testing.assert_array_equal(imu0["T_i_b"], np.eye(4))
    assert imu0["update_rate"] == 200.0
    assert imu0["gyroscope_noise_density"] == 1.6968e-4


def test_a_folder_is_a_calibration(
    euroc: Path, uzh_fpv: Path, assert_same_rig: Callable[[StereoRig, StereoRig], None]
) -> None:
    """`--calibration` takes the folder of a data set, and takes its noise too."""
    own = open_sequence(uzh_fpv)
    assert own.rig.baseline != pytest.approx(open_sequence(euroc).rig.baseline)
    given = open_sequence(euroc, calibration=uzh_fpv)
    assert_same_rig(given.rig, own.rig)
    assert given.rig.time_offset_s == own.rig.time_offset_s
    assert given.imu_noise == own.imu_noise


def test_a_folder_is_the_calibration_of_a_bag(
    tmp_path: Path, euroc: Path, assert_same_rig: Callable[[StereoRig, StereoRig], None]
) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": mono, "/imu": imu})
    recorded = open_recording(path, calibration=euroc)
    assert_same_rig(recorded.rig, open_sequence(euroc).rig)
    assert recorded.imu_noise == open_sequence(euroc).imu_noise


def test_command(ovmot_command: Callable[..., Any], euroc: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "chain.yaml"
    said = ovmot_command("calibrate", euroc, "-o", out)
    assert (said.code, out.exists()) == (2, False)
    assert "an axis of the gyroscope never changes" in said.complaint
    said = ovmot_command("calibrate", euroc, "-o", out, "--force")  # two frames: no run can start
    assert (said.code, out.exists()) == (1, False)
    said = ovmot_command("calibrate", euroc, "--as-is", "-o", out)
    assert said.code == 0, said.err
    assert said.out == f"{euroc} -> {out}, {out.with_name('kalibr_imu_chain.yaml')}\n"
    assert "is there already" in ovmot_command("calibrate", euroc, "--as-is", "-o", out).complaint
