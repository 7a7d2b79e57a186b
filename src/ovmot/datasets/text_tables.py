"""Tables of stamps that are separated by blanks: in nanoseconds, or in decimal seconds."""

from pathlib import Path

import numpy as np

from ovmot.datasets.pose_files import (
    Lines,
    StampedNames,
    StampedTable,
    is_stamp,
    read_lines,
    seconds_to_ns,
)
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import IntArray

_REMEDY = "correct or delete the row"


def read_stamped_text(path: Path, n_columns: int) -> StampedTable:
    """Whole nanoseconds, then `n_columns` - 1 numbers; `DatasetError` names the first other row."""
    lines = read_lines(path, DatasetError)
    layout = np.dtype([("stamp", "i8"), ("values", "f8", (n_columns - 1,))])
    table = lines.parse(layout, n_columns, None)
    return StampedTable(path, table["stamp"], table["values"], lines.row)


def read_stamped_list(path: Path) -> StampedNames:
    """Whole nanoseconds at the start of each row; what follows them is left out.

    Raises `DatasetError` naming the first row that is something else.
    """
    lines = read_lines(path, DatasetError).with_data()
    stamps = []
    for row, text in zip(lines.row, lines.text, strict=True):
        stamp = text.split(None, 1)[0]
        if not is_stamp(stamp):
            problem = f"'{stamp[:40]}' is not a stamp in whole nanoseconds"
            raise DatasetError.at(path, problem, _REMEDY, row=int(row))
        stamps.append(int(stamp))
    return StampedNames(path, np.array(stamps, dtype=np.int64), ("",) * len(stamps), lines.row)


def read_timed_text(path: Path, n_columns: int, time_column: int) -> StampedTable:
    """Numbers, of which `time_column` holds decimal seconds.

    `values` are the columns after it; those before it (a running number) are left out.
    Raises `DatasetError` naming the first row that is something else.
    """
    lines = read_lines(path, DatasetError)
    values = lines.parse(np.dtype(np.float64), n_columns, None)
    return StampedTable(path, _stamps(lines, time_column), values[:, time_column + 1 :], lines.row)


def read_timed_names(path: Path) -> StampedNames:
    """Rows of a running number, decimal seconds and the name of a file.

    Raises `DatasetError` naming the first row that is something else.
    """
    lines = read_lines(path, DatasetError).with_data()
    names = []
    for row, text in zip(lines.row, lines.text, strict=True):
        fields = text.split(None, 2)
        if len(fields) != 3:
            problem = f"{len(fields)} columns where 3 are expected"
            remedy = "a row is: number, seconds, file name"
            raise DatasetError.at(path, problem, remedy, row=int(row))
        names.append(fields[2])
    return StampedNames(path, _stamps(lines, 1), tuple(names), lines.row)


def _stamps(lines: Lines, column: int) -> IntArray:
    """Nanoseconds (N,) of a column of decimal seconds."""
    stamps = []
    for row, text in zip(lines.row, lines.text, strict=True):
        try:
            stamps.append(seconds_to_ns(text.split()[column]))
        except ValueError as error:
            raise DatasetError.at(lines.path, str(error), _REMEDY, row=int(row)) from None
    return np.array(stamps, dtype=np.int64)
