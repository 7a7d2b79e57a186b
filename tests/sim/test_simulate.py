"""A simulated sequence of the public API: its events are what the written folder gives."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.registry import open_recording
from ovmot.errors import InputError
from ovmot.sim.simulate import SimulatedSequence, simulate
from ovmot.types import ImuSample, StereoFrame


@pytest.fixture(scope="module")
def sequence() -> SimulatedSequence:
    return simulate("demo", seed=3, duration_s=0.3, size=(160, 70))


def test_events_are_those_of_the_folder(sequence: SimulatedSequence, tmp_path: Path) -> None:
    written: list[int] = []
    sequence.write(str(tmp_path / "data"), "asl", written.append)
    assert written == [1, 2, 3]
    read = open_recording(str(tmp_path / "data"))
    pairs = list(zip(sequence, read, strict=True))
    assert sum(isinstance(event, StereoFrame) for event, _ in pairs) == len(sequence) == 3
    for made, found in pairs:
        assert type(made) is type(found)
        assert made.timestamp_ns == found.timestamp_ns
        if isinstance(made, StereoFrame) and isinstance(found, StereoFrame):
            np.testing.assert_array_equal(made.left, found.left)
            np.testing.assert_array_equal(made.right, found.right)
        elif isinstance(made, ImuSample) and isinstance(found, ImuSample):
            np.testing.assert_allclose(made.gyro, found.gyro, atol=1e-9)
            np.testing.assert_allclose(made.accel, found.accel, atol=1e-9)


def test_each_pass_gives_the_same(sequence: SimulatedSequence) -> None:
    passes = [[e for e in sequence if isinstance(e, StereoFrame)] for _ in range(2)]
    for a, b in zip(*passes, strict=True):
        np.testing.assert_array_equal(a.left, b.left)


def test_stamps_and_true_poses(sequence: SimulatedSequence) -> None:
    frames = [e.timestamp_ns for e in sequence if isinstance(e, StereoFrame)]
    assert sequence.frame_ns.tolist() == frames
    assert sequence.T_world_imu.shape == (3, 4, 4)
    assert np.abs(sequence.T_world_imu[:, :3, 3] - sequence.T_world_imu[0, :3, 3]).max() < 0.02
    assert sequence.imu_noise.gyro > 0.0


def test_another_rig_sees_its_own_images() -> None:
    camera = Camera.make((96, 64), (70.0, 70.0), (47.5, 31.5))
    left, right = np.eye(4), np.eye(4)
    left[:3, :3] = right[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    left[1, 3], right[1, 3] = 0.2, -0.2
    rig = StereoRig.make(camera, camera, left, right)
    sequence = simulate("demo", duration_s=0.1, rig=rig)
    assert sequence.rig is rig
    (frame,) = (event for event in sequence if isinstance(event, StereoFrame))
    assert frame.left.shape == frame.pair[1].shape == (64, 96)
    assert (frame.left != frame.right).mean() > 0.3


def test_what_is_not_known_is_refused(sequence: SimulatedSequence, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="format mp4: unknown; choose one of asl, kaist"):
        sequence.write(tmp_path / "data", "mp4")
    with pytest.raises(InputError, match="nowhere: neither a scene of the catalog nor a file"):
        simulate("nowhere")
    with pytest.raises(InputError, match="duration of -1 s"):
        simulate("demo", duration_s=-1.0)
