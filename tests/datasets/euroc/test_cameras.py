"""EuRoC folders with one camera, and with a chain of cameras of one's own."""

import shutil
from pathlib import Path

import pytest

from ovmot.datasets.bag.topics import BagTopics
from ovmot.datasets.calibration import kalibr_keys
from ovmot.datasets.kalibr import write_yaml
from ovmot.datasets.registry import open_recording, open_sequence
from ovmot.datasets.stream import events
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.types import StereoFrame


def one_camera_chain(path: Path, euroc: Path) -> Path:
    rig = open_sequence(euroc).rig
    cam0 = {
        **kalibr_keys(rig.cam0),
        "T_cam_imu": se3.inverse(rig.T_imu_cam0).tolist(),
        "resolution": [rig.cam0.width, rig.cam0.height],
    }
    write_yaml(path, {"cam0": cam0})
    return path


def test_a_chain_of_one_camera_reads_the_left_images_alone(euroc: Path, tmp_path: Path) -> None:
    sequence = open_sequence(euroc, calibration=one_camera_chain(tmp_path / "c.yaml", euroc))
    assert sequence.rig.n_cameras == 1
    assert len(sequence) == len(open_sequence(euroc))
    seen = [e for e in events(sequence) if isinstance(e, StereoFrame)]
    assert len(seen) == len(sequence)
    assert all(frame.right is None for frame in seen)


def test_a_folder_without_a_right_camera(euroc: Path) -> None:
    expected = len(open_sequence(euroc))
    mav = euroc if euroc.name == "mav0" else euroc / "mav0"
    shutil.rmtree(mav / "cam1")
    sequence = open_sequence(euroc)
    assert sequence.rig.n_cameras == 1
    assert len(sequence) == expected
    assert any("holds no cam1: run with one camera" in w for w in sequence.warnings)


def test_left_and_right_name_cameras_of_a_chain_only(euroc: Path, tmp_path: Path) -> None:
    chain = one_camera_chain(tmp_path / "c.yaml", euroc)
    assert open_recording(euroc, calibration=chain, topics=BagTopics("cam0")).rig.n_cameras == 1
    with pytest.raises(InputError, match="is no bag; leave out '--left /a'"):
        open_recording(euroc, topics=BagTopics("/a"))
