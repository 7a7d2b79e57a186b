"""Rows with stamps: exact times, honest errors."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import text_tables as formats
from ovmot.errors import DatasetError, InputError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1403636584.763555584", 1403636584763555584),
        ("1403636584.76356", 1403636584763560000),
        ("1.403636584763555584e+09", 1403636584763555584),
        ("0", 0),
        ("-0.000000001", -1),
        ("1.0000000004", 1_000_000_000),
    ],
)
def test_seconds_become_exact_nanoseconds(text: str, expected: int) -> None:
    assert formats.seconds_to_ns(text) == expected


@pytest.mark.parametrize("text", ["", "abc", "nan", "inf", "1,5", "1e999999", "1e20", "-1e20"])
def test_other_text_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="not a time"):
        formats.seconds_to_ns(text)


@pytest.mark.parametrize("stamp", [0, 1, -1, 999_999_999, -1_500_000_000, 1403636584763555584])
def test_nanoseconds_survive_the_way_through_text(stamp: int) -> None:
    assert formats.seconds_to_ns(formats.ns_to_seconds(stamp)) == stamp


def test_table_of_stamps_and_values(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv"
    path.write_text("timestamp,x,y\n1403636584763555585, 1.5,-2e-3\n\n1403636584763555587,0,3\n")
    table = formats.read_stamped_csv(path, 3)
    assert table.timestamp_ns.tolist() == [1403636584763555585, 1403636584763555587]
    np.testing.assert_array_equal(table.values, [[1.5, -2e-3], [0.0, 3.0]])
    assert table.row.tolist() == [2, 4]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("2,0.1", "2 columns where 3"),
        ("2,0.1,0.2,0.3", "4 columns where 3"),
        ("2,0.1,", "'' is not a number"),
        ("2,0.1,inf", "not finite"),
        ("1.5e18,0.1,0.2", "not a stamp"),
        ("99999999999999999999,0.1,0.2", "not a stamp"),
    ],
)
def test_a_bad_table_row_is_named(tmp_path: Path, row: str, message: str) -> None:
    path = tmp_path / "imu.csv"
    path.write_text(f"#t,x,y\n1,0,0\n{row}\n3,0,0\n")
    with pytest.raises(DatasetError, match=message) as caught:
        formats.read_stamped_csv(path, 3)
    assert f"{path}, row 3:" in str(caught.value)


def test_empty_missing_and_binary_tables(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("#t,x\n")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    for name, message in (("empty", "no data"), ("gone", "no such file"), ("binary", "as text")):
        with pytest.raises(DatasetError, match=message):
            formats.read_stamped_csv(tmp_path / f"{name}.csv", 2)


def test_stamps_of_absurd_length_are_no_stamps(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text(f"1,2\n{'1' * 5000},3\n")
    with pytest.raises(InputError, match=r"data\.csv, row 2: '1{40}' is not a stamp"):
        formats.read_stamped_csv(path, 2)


def test_names_of_columns_may_follow_a_comment(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("# made by hand\n\ntimestamp,value\n1,2\n")
    table = formats.read_stamped_csv(path, 2)
    assert table.timestamp_ns.tolist() == [1]
    assert table.row.tolist() == [4]
