"""KITTI tracking and odometry folders."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import DatasetError, InputError

Edit = Callable[[Path, str, str], None]


def test_kitti_tracking_has_ten_frames_a_second(kitti_tracking: Path) -> None:
    sequence = open_sequence(kitti_tracking)
    assert (sequence.kind, sequence.name, sequence.imu) == ("kitti", "0010", None)
    assert sequence.frame_ns.tolist() == [0, 100_000_000, 200_000_000, 300_000_000]


def test_frames_keep_the_numbers_of_kitti_s_images(kitti_tracking: Path, euroc: Path) -> None:
    for camera in ("image_02", "image_03"):
        (kitti_tracking / camera / "0010" / "000001.png").unlink()
    assert open_sequence(kitti_tracking).frame_number.tolist() == [0, 2, 3]
    others = open_sequence(euroc)
    assert others.frame_number.tolist() == list(range(len(others)))


def test_kitti_tracking_with_several_sequences(kitti_tracking: Path) -> None:
    shutil.copytree(kitti_tracking / "image_02" / "0010", kitti_tracking / "image_02" / "0011")
    with pytest.raises(InputError, match=r"choose one with --sequence; there are: 0010, 0011"):
        open_sequence(kitti_tracking)
    assert open_sequence(kitti_tracking.parent, sequence="0010").name == "0010"
    with pytest.raises(InputError, match="no sequence '0099'"):
        open_sequence(kitti_tracking, sequence="0099")


def test_kitti_odometry(kitti_odometry: Path) -> None:
    for path in (kitti_odometry, kitti_odometry / "sequences", kitti_odometry / "sequences" / "00"):
        sequence = open_sequence(path)
        assert (sequence.kind, sequence.name) == ("kitti", "00")
        assert sequence.frame_ns.tolist() == [0, 103_859_000, 207_600_000]


def test_kitti_odometry_needs_a_time_for_each_frame(kitti_odometry: Path, edit: Edit) -> None:
    times = kitti_odometry / "sequences" / "00" / "times.txt"
    edit(times, "2.076000e-01\n", "")
    with pytest.raises(DatasetError, match="2 times, but an image of number 2"):
        open_sequence(kitti_odometry)
    times.write_text("0.0\n0.2\n0.1\n")
    with pytest.raises(DatasetError, match=r"row 3: .*does not lie after"):
        open_sequence(kitti_odometry)
    times.write_text("0.0\nsoon\n0.1\n")
    with pytest.raises(DatasetError, match="row 2: 'soon' is not a time"):
        open_sequence(kitti_odometry)
