"""KAIST folders."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import DatasetError

FIRST_NS = 1_403_636_580_000_000_555


def test_kaist(kaist: Path) -> None:
    sequence = open_sequence(kaist)
    assert (sequence.kind, sequence.name, len(sequence)) == ("kaist", "urban_tiny", 6)
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.gyro[0], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[0], [0.0, 0.5, 9.8])
    assert sequence.counts == {"stamps_without_image": 1}
    assert "1 of 7 stamps" in sequence.warnings[0]


def test_early_kaist_imu_has_no_gyro(kaist: Path) -> None:
    (kaist / "sensor_data" / "xsens_imu.csv").write_text("1,0,0,0,1,0,0,0\n" * 3)
    with pytest.raises(DatasetError, match="8 columns: this early KAIST sequence"):
        open_sequence(kaist)
