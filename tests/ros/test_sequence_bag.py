"""A sequence in bags of every kind: read back equal, and a run makes the same of it."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml

from ovmot.cameras.rig import StereoRig
from ovmot.datasets import open_recording
from ovmot.datasets.stream import events
from ovmot.ros.bag_output import write_sequence_bag
from ovmot.run import RunOptions, run_sequence
from ovmot.settings import Settings
from ovmot.types import ImuSample, StereoFrame

KINDS = ("tiny.bag", "tiny.mcap", "tiny")
SETTINGS = Settings.model_validate(
    {
        "tracker": {
            "max_features": 120, "min_distance_px": 10.0, "fast_threshold": 12,
            "equalization": "none", "klt_window_px": 13, "klt_levels": 3,
        },
        "initialization": {"window_s": 0.5},
    }
)  # fmt: skip


def write_chain(path: Path, rig: StereoRig) -> Path:
    """A Kalibr chain of the rig."""
    cameras = {
        name: {
            "T_imu_cam": T_imu_cam.tolist(),
            "intrinsics": camera.intrinsics[:4].tolist(),
            "distortion_model": camera.lens.name,
            "distortion_coeffs": camera.distortion.tolist(),
            "resolution": [camera.width, camera.height],
        }
        for name, camera, T_imu_cam in (
            ("cam0", rig.cam0, rig.T_imu_cam0),
            ("cam1", rig.cam1, rig.T_imu_cam1),
        )
    }
    path.write_text(yaml.safe_dump(cameras))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_gives_the_same_events(painted_euroc: Path, tmp_path: Path, kind: str) -> None:
    folder = open_recording(painted_euroc)
    assert write_sequence_bag(tmp_path / kind, folder) == 12
    chain = write_chain(tmp_path / "chain.yaml", folder.rig)
    bag = open_recording(tmp_path / kind, calibration=chain)
    assert (bag.kind, len(bag), bag.warnings) == ("bag", 12, ())
    assert np.array_equal(bag.frame_ns, folder.frame_ns)
    assert bag.rig.T_imu_cam1 == pytest.approx(folder.rig.T_imu_cam1)
    pairs = list(zip(events(bag), events(folder), strict=True))
    assert len(pairs) > 200
    for ours, theirs in pairs:
        assert ours.timestamp_ns == theirs.timestamp_ns
        if isinstance(ours, ImuSample):
            assert isinstance(theirs, ImuSample)
            assert np.array_equal(ours.gyro, theirs.gyro)
            assert np.array_equal(ours.accel, theirs.accel)
        else:
            assert isinstance(ours, StereoFrame) and isinstance(theirs, StereoFrame)
            assert np.array_equal(ours.left, theirs.left)
            assert np.array_equal(ours.right, theirs.right)


def test_frames_in_the_middle_of_a_bag(painted_euroc: Path, tmp_path: Path) -> None:
    folder = open_recording(painted_euroc)
    write_sequence_bag(tmp_path / "tiny.bag", folder)
    chain = write_chain(tmp_path / "chain.yaml", folder.rig)
    bag = open_recording(tmp_path / "tiny.bag", calibration=chain)
    chosen = [e for e in events(bag, first=3, last=5) if isinstance(e, StereoFrame)]
    assert [e.timestamp_ns for e in chosen] == folder.frame_ns[3:6].tolist()
    left, _ = next(folder.pairs(3, 4))
    assert np.array_equal(chosen[0].left, left.decode())


def test_a_run_from_a_bag_is_the_run_from_the_folder(painted_euroc: Path, tmp_path: Path) -> None:
    folder = open_recording(painted_euroc)
    noise = folder.imu_noise
    assert noise is not None
    told = {f"{f.name}_noise".replace("walk_noise", "walk"): getattr(noise, f.name)
            for f in fields(noise)}  # fmt: skip
    settings = SETTINGS.model_copy(update={"imu": SETTINGS.imu.model_copy(update=told)})
    run_sequence(folder, settings, RunOptions(tmp_path / "folder"))
    expected = (tmp_path / "folder" / "state.csv").read_bytes()
    assert expected.count(b"\n") > 6
    chain = write_chain(tmp_path / "chain.yaml", folder.rig)
    for kind in KINDS:
        write_sequence_bag(tmp_path / kind, folder)
        bag = open_recording(tmp_path / kind, calibration=chain)
        out = tmp_path / f"out_{kind}"
        run_sequence(bag, settings, RunOptions(out))
        assert (out / "state.csv").read_bytes() == expected
