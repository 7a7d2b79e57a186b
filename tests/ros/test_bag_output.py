"""The results of a run as a bag."""

from collections import Counter
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from ovmot.cameras.rig import StereoRig
from ovmot.datasets import open_recording
from ovmot.datasets.stream import events
from ovmot.ros import messages
from ovmot.ros.bag_output import BagOutput, write_sequence_bag
from ovmot.run import RunOptions, run_sequence
from ovmot.settings import Settings
from ovmot.types import FrameResult, ImuSample, StereoFrame


def topics_in(path: Path) -> Counter[str]:
    with AnyReader([path]) as reader:
        return Counter(connection.topic for connection, _, _ in reader.messages())


def write(path: Path, rig: StereoRig, result: FrameResult, **options: Any) -> None:
    output = BagOutput(path, rig, **options)
    for i in range(3):
        stamp = result.timestamp_ns + i * 10**8
        frame = replace(result.frame, timestamp_ns=stamp)
        ego = replace(result.ego, timestamp_ns=stamp)
        output.write(replace(result, frame=frame, ego=ego))
    output.close()


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_every_topic_has_a_message_a_frame(
    tmp_path: Path, rig_of_result: StereoRig, result: FrameResult, name: str
) -> None:
    path = tmp_path / "new" / name
    write(path, rig_of_result, result, overlay=True)
    wanted_topics = Counter(dict.fromkeys(messages.TOPICS, 3))
    wanted_topics[messages.TF_STATIC] = 1
    assert topics_in(path) == wanted_topics
    assert [p.name for p in path.parent.iterdir()] == [name]
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic == messages.OBJECTS]
        stamps = []
        for connection, recorded_ns, data in reader.messages(wanted):
            said = reader.deserialize(data, connection.msgtype)
            stamps.append(recorded_ns)
            assert [o.id for o in said.objects] == [7, 8, 9]  # type: ignore[attr-defined]
    assert stamps == [result.timestamp_ns + i * 10**8 for i in range(3)]


def test_without_the_video_there_is_no_overlay(
    tmp_path: Path, painted_rig: StereoRig, result: FrameResult
) -> None:
    write(tmp_path / "out.bag", painted_rig, result)
    assert messages.OVERLAY not in topics_in(tmp_path / "out.bag")


def test_run_writes_a_bag_beside_its_folder(
    painted_euroc: Path, tmp_path: Path, ovmot_command: Callable[..., Any]
) -> None:
    settings = ("--set", "initialization.window_s=0.5", "--set", "tracker.max_features=120")
    bag = tmp_path / "results.mcap"

    def run(out: str, *more: str) -> Any:
        found = ("-o", tmp_path / out, "--bag", bag, *settings, *more)
        return ovmot_command("run", painted_euroc, *found)

    assert run("a").code == 0
    frames = (tmp_path / "a" / "trajectory.tum").read_text().count("\n")
    assert topics_in(bag)[messages.ODOMETRY] == frames > 5
    found = run("b")
    assert found.code == 2
    assert found.complaint == f"ovmot: {bag}: is already there; replace it with --force"
    assert run("b", "--force").code == 0


KINDS = ("tiny.bag", "tiny.mcap", "tiny")


SETTINGS = Settings.model_validate(
    {
        "tracker": {
            "max_features": 120, "fast_threshold": 12,
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
            "distortion_model": camera.model.name,
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
            assert np.array_equal(ours.pair[1], theirs.pair[1])


def test_frames_in_the_middle_of_a_bag(painted_euroc: Path, tmp_path: Path) -> None:
    folder = open_recording(painted_euroc)
    write_sequence_bag(tmp_path / "tiny.bag", folder)
    chain = write_chain(tmp_path / "chain.yaml", folder.rig)
    bag = open_recording(tmp_path / "tiny.bag", calibration=chain)
    chosen = [e for e in events(bag, first=3, last=5) if isinstance(e, StereoFrame)]
    assert [e.timestamp_ns for e in chosen] == folder.frame_ns[3:6].tolist()
    left, _ = next(folder.pairs(3, 4))
    assert left is not None
    assert np.array_equal(chosen[0].left, left.decode())


def test_a_run_from_a_bag_is_the_run_from_the_folder(painted_euroc: Path, tmp_path: Path) -> None:
    folder = open_recording(painted_euroc)
    noise = folder.imu_noise
    assert noise is not None
    found = {f"{f.name}_noise".replace("walk_noise", "walk"): getattr(noise, f.name)
            for f in fields(noise)}  # fmt: skip
    settings = SETTINGS.model_copy(update={"imu": SETTINGS.imu.model_copy(update=found)})
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
