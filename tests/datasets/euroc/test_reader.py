"""EuRoC folders."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ovmot.datasets import open_sequence

Edit = Callable[[Path, str, str], None]


FIRST_NS = 1_403_636_580_000_000_555


def test_euroc(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert (sequence.kind, sequence.name, len(sequence)) == ("euroc", "MH_tiny", 6)
    assert sequence.frame_ns.tolist() == [FIRST_NS + i * 100_000_000 for i in range(6)]
    assert sequence.imu is not None
    assert len(sequence.imu) == 121
    np.testing.assert_array_equal(sequence.imu.gyro[7], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[7], [0.0, 0.5, 9.8])
    assert sequence.imu_noise is not None
    assert sequence.imu_noise.gyro_walk == 1.9393e-5
    assert sequence.warnings == ()
    assert open_sequence(euroc / "mav0").name == "MH_tiny"


def test_euroc_without_lists_of_images(euroc: Path) -> None:
    for camera in ("cam0", "cam1"):
        (euroc / "mav0" / camera / "data.csv").unlink()
    assert len(open_sequence(euroc)) == 6


def test_euroc_imu_off_the_body(euroc: Path, edit: Edit) -> None:
    """The rig is found in the IMU's frame, also where the body is another one."""
    edit(euroc / "mav0" / "imu0" / "sensor.yaml", "[1,0,0,0, ", "[1,0,0,0.02, ")
    rig = open_sequence(euroc).rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [0.08, 0.05, 0.0], atol=1e-12)
