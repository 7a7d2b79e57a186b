"""The handheld rig along a recorded path."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.pose_files import write_tum
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.sim.features import FeatureOptions
from ovmot.sim.handheld import ORIGIN_NS, handheld_rig, handheld_simulation


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Ten seconds ahead at 0.5 m/s, a pose every 0.1 s."""
    stamps = 100_000_000 * np.arange(101, dtype=np.int64)
    position = np.stack([5e-10 * stamps, np.zeros(101), np.ones(101)], axis=-1)
    write_tum(
        tmp_path / "walk.txt", stamps, se3.make(np.broadcast_to(np.eye(3), (101, 3, 3)), position)
    )
    return tmp_path / "walk.txt"


def test_frames_come_at_the_asked_rate(walk: Path) -> None:
    simulation = handheld_simulation(walk, FeatureOptions(), duration_s=4.0, camera_hz=20.0)
    assert simulation.camera_ns[0] == ORIGIN_NS
    assert np.all(np.diff(simulation.camera_ns) == 50_000_000)
    assert simulation.imu.rate_hz == 400.0
    speed = np.linalg.norm(simulation.path.velocity(simulation.camera_ns[10:20]), axis=1)
    np.testing.assert_allclose(speed, 0.5, rtol=0.02)


def test_rates_that_nothing_has_are_refused(walk: Path) -> None:
    for camera_hz, imu_hz in ((0.0, 400.0), (500.0, 1000.0), (20.0, 10.0)):
        with pytest.raises(InputError, match="can not be simulated"):
            handheld_simulation(walk, FeatureOptions(), camera_hz=camera_hz, imu_hz=imu_hz)


def test_the_rig_is_narrow_and_wide_angled() -> None:
    rig = handheld_rig()
    assert rig.baseline == pytest.approx(0.11, rel=0.01)
    edge = rig.cam0.normalize(np.array([[0.0, 240.0], [751.0, 240.0]]))
    assert np.degrees(np.arctan(np.abs(edge[:, 0])).sum()) > 75.0
