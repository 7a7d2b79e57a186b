"""UZH-FPV folders, and what is refused."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from variant_fixtures import write_chain

from ovmot.datasets import open_sequence
from ovmot.errors import CalibrationError, DatasetError

Edit = Callable[[Path, str, str], None]


def test_uzh_fpv(uzh_fpv: Path) -> None:
    sequence = open_sequence(uzh_fpv)
    assert (sequence.kind, len(sequence), sequence.warnings) == ("uzh_fpv", 6, ())
    assert sequence.frame_ns.tolist() == [1540821844 * 10**9 + n * 10**8 for n in range(6)]
    assert sequence.imu is not None
    assert sequence.imu.timestamp_ns[1] == 1540821843_910_000_000
    np.testing.assert_array_equal(sequence.imu.gyro[3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[3], [0.0, 0.5, 9.8])
    assert sequence.rig.baseline == pytest.approx(0.1)
    assert sequence.imu_noise is not None


def test_uzh_fpv_imu_without_numbers(uzh_fpv: Path) -> None:
    rows = (uzh_fpv / "imu.txt").read_text().split("\n")[1:]
    (uzh_fpv / "imu.txt").write_text("\n".join(row.split(" ", 1)[1] for row in rows))
    assert open_sequence(uzh_fpv).counts == {}


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("imu.txt", "1540821843.910", "noon", "row 3: 'noon' is not a number"),
        ("imu.txt", "0.3 0 0.5 9.8\n", "0.3\n", "5 columns; 7 or 8 are known"),
        ("left_images.txt", "2 1540821844.20 ", "2 ", "row 4: 2 columns where 3"),
        ("left_images.txt", "1540821844.20", "soon", "row 4: 'soon' is not a time in seconds"),
        ("right_images.txt", "img/", "images/", "none of its 6 images is there"),
    ],
)
def test_broken_uzh_fpv_files(
    uzh_fpv: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(uzh_fpv / name, old, new)
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(uzh_fpv)
    assert str(uzh_fpv / name) in str(caught.value)


def test_uzh_fpv_without_calibration(uzh_fpv: Path) -> None:
    shutil.rmtree(uzh_fpv.parent / "indoor_forward_calib_snapdragon")
    with pytest.raises(CalibrationError, match=r"no calibration .* give it with --calibration"):
        open_sequence(uzh_fpv)
    write_chain(uzh_fpv.parent / "mine.yaml")
    found = open_sequence(uzh_fpv, calibration=uzh_fpv.parent / "mine.yaml")
    assert found.rig.baseline == pytest.approx(0.1)
