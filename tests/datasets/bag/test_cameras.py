"""Bags of one camera, and of more than two."""

from pathlib import Path

import numpy as np
import pytest
from bag_fixtures import COLOURS, START_NS, camera_info, frames, mono, write_bag

from ovmot.datasets.bag.topics import BagTopics
from ovmot.datasets.registry import open_recording
from ovmot.errors import CalibrationError

CAMERA = """
  intrinsics: [20.0, 21.0, 16.0, 12.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.001, 0.0002]
  resolution: [32, 24]
"""


def chain_of(path: Path, n: int, topics: bool = True) -> Path:
    cameras = []
    for k in range(n):
        T = f"[[0, -1, 0, {-0.3 * k}], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]"
        topic = f"  rostopic: /eye{k}/image\n" if topics else ""
        cameras.append(f"cam{k}:\n  T_cam_imu: {T}{CAMERA}{topic}")
    path.write_text("".join(cameras))
    return path


def test_a_bag_of_one_image_topic(tmp_path: Path, chain: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/only": mono})
    sequence = open_recording(path, calibration=chain)  # of two cameras
    assert sequence.rig.n_cameras == 1
    assert f"{path}: one camera, /only" in sequence.warnings
    seen = frames(path, chain)
    assert [f.timestamp_ns for f in seen] == [START_NS + i * 10**8 for i in range(6)]
    assert all(f.right is None and np.array_equal(f.left, COLOURS[:, :, 0]) for f in seen)
    stored, none = next(sequence.pairs(2, 3))
    assert stored is not None and none is None
    np.testing.assert_array_equal(stored.decode(), COLOURS[:, :, 0])


def test_one_camera_by_camera_info_and_a_mount(tmp_path: Path, mount: Path) -> None:
    cameras = {"/left/image_raw": mono, "/left/camera_info": camera_info(False)}
    rig = open_recording(write_bag(tmp_path / "t.bag", cameras), calibration=mount).rig
    assert rig.n_cameras == 1
    assert rig.time_offset_s == 0.002
    assert rig.cam0.intrinsics[:4] == pytest.approx([20.0, 21.0, 16.0, 12.0])


def test_a_chain_of_one_camera_takes_one_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/a": mono, "/b": mono, "/eye0/image": mono})
    named, nameless = chain_of(tmp_path / "1.yaml", 1), chain_of(tmp_path / "2.yaml", 1, False)
    for chain, topics, expected in (
        (named, BagTopics(), "/eye0/image"),
        (nameless, BagTopics(), "/a"),
        (named, BagTopics("/b"), "/b"),
    ):
        sequence = open_recording(path, calibration=chain, topics=topics)
        assert f"{path}: one camera, {expected}" in sequence.warnings


def test_of_three_cameras_the_chain_names_the_topics(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {f"/eye{k}/image": mono for k in (2, 1, 0)})
    chain = chain_of(tmp_path / "chain.yaml", 3)
    first = open_recording(path, calibration=chain)
    assert first.rig.baseline == pytest.approx(0.3)
    assert any("3 cameras, of which cam0 is taken as the left" in w for w in first.warnings)
    for asked in (BagTopics("cam0", "cam2"), BagTopics("/eye0/image", "/eye2/image")):
        wide = open_recording(path, calibration=chain, topics=asked)
        assert wide.rig.baseline == pytest.approx(0.6)
        assert any("cam2 as the right one" in w for w in wide.warnings)
    nameless = chain_of(tmp_path / "nameless.yaml", 3, False)
    with pytest.raises(CalibrationError, match="the chain has no rostopic for cam0"):
        open_recording(path, calibration=nameless, topics=BagTopics("cam0", "cam2"))
