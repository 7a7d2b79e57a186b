"""The checks that every IMU table passes."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.findings import Findings
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.text_tables import StampedTable
from ovmot.errors import DatasetError

Edit = Callable[[Path, str, str], None]


FIRST_NS = 1_403_636_580_000_000_555


def imu_file(root: Path) -> Path:
    return root / "mav0" / "imu0" / "data.csv"


def test_imu_values_that_no_sensor_gives(euroc: Path) -> None:
    rows = imu_file(euroc).read_text().splitlines()
    rows[50] = rows[50].rpartition(",")[0] + ",1e300"
    imu_file(euroc).write_text("\n".join(rows))
    with pytest.raises(DatasetError, match=r"data\.csv, row 51: .*no sensor measures; correct or"):
        open_sequence(euroc)


def test_a_message_without_a_number_is_refused() -> None:
    """Files are refused where they are read; messages of a bag hold any number."""
    values = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, z] for z in (9.8, np.nan, 9.8)])
    table = StampedTable("x.bag, topic /imu", np.arange(3) * 10_000_000, values, np.arange(3) + 1)
    with pytest.raises(DatasetError, match=r"x\.bag, topic /imu, row 2: .*no sensor measures"):
        checked_imu(table, 0, 3, 0.1, Findings())


def test_spikes_are_left_out_and_a_dead_gyroscope_is_said(euroc: Path) -> None:
    rows = imu_file(euroc).read_text().splitlines()
    rows[50] = rows[50].rpartition(",")[0] + ",1e4"
    imu_file(euroc).write_text("\n".join(rows))
    spiked = open_sequence(euroc)
    assert spiked.counts["imu_beyond_range"] == 1
    assert any("1 rows, the first is row 51, beyond" in text for text in spiked.warnings)
    assert spiked.imu is not None
    assert len(spiked.imu) == len(rows) - 2  # and the names of the columns
    assert np.abs(spiked.imu.accel).max() < 100.0
    for i in range(60, 70):
        rows[i] = rows[i].rpartition(",")[0] + ",1e4"
    imu_file(euroc).write_text("\n".join(rows))
    full = open_sequence(euroc)
    assert full.imu is not None
    assert len(full.imu) == len(rows) - 1
    assert any("so many are no spikes" in text for text in full.warnings)
    still = [f"{row.split(',')[0]},0,0,0,0,0,9.8" for row in rows[1:]]
    imu_file(euroc).write_text("\n".join(still))
    assert "the gyroscope is 0 throughout" in open_sequence(euroc).warnings[0]


def test_no_imu_is_said(euroc: Path) -> None:
    shutil.rmtree(euroc / "mav0" / "imu0")
    sequence = open_sequence(euroc)
    assert sequence.imu is None
    assert sequence.counts == {"no_imu": 1, "no_imu_noise": 1}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("{stamp},0,0,0,0,0", "6 columns where 7 are expected"),
        ("{stamp},0,0,0,0,0,nan", "not finite"),
        ("{stamp},0,0,0,0,0,9.8x", "'9.8x' is not a number"),
        ("garbage", "1 columns where 7"),
    ],
)
def test_bad_imu_rows(euroc: Path, row: str, message: str) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    lines[50] = row.format(stamp=lines[50].split(",")[0])
    path.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(euroc)
    assert f"{path}, row 51:" in str(caught.value)


def test_imu_stamps_twice_and_backwards(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:10], lines[9], lines[9], *lines[10:]]))
    sequence = open_sequence(euroc)
    assert sequence.imu is not None
    assert (len(sequence.imu), sequence.counts) == (121, {"imu_duplicates": 2})
    path.write_text("\n".join([*lines[:10], lines[12], *lines[10:]]))  # rows 12 to 14 come late
    late = open_sequence(euroc)
    assert late.imu is not None
    assert (len(late.imu), late.counts) == (119, {"imu_duplicates": 1, "imu_rows_out_of_order": 2})
    assert np.all(np.diff(late.imu.timestamp_ns) > 0)
    assert any("the first is row 12: dropped" in text for text in late.warnings)
    path.write_text("\n".join([lines[0], *reversed(lines[1:])]))
    with pytest.raises(DatasetError, match=r"data\.csv, row 3: most stamps do not follow"):
        open_sequence(euroc)


def test_imu_gaps_are_counted_by_the_setting(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    del lines[40:62], lines[20:30]
    path.write_text("\n".join(lines))
    sequence = open_sequence(euroc)
    assert sequence.counts == {"imu_gaps": 1}
    assert "the largest 0.115 s at" in sequence.warnings[0]
    assert open_sequence(euroc, imu_max_gap_s=0.05).counts == {"imu_gaps": 2}


@pytest.mark.parametrize(("value", "hint"), [("1.0", "may be g"), ("16384", "raw counts")])
def test_imu_units_that_look_wrong(euroc: Path, edit: Edit, value: str, hint: str) -> None:
    edit(imu_file(euroc), ",0.5,9.8", f",0.0,{value}")
    sequence = open_sequence(euroc)
    assert sequence.counts == {"imu_units": 1}
    assert hint in sequence.warnings[0]
