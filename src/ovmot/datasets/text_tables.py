"""Text tables whose rows carry a time stamp: the readers that all data sets share.

Stamps stay exact: nanoseconds are read as integers and seconds as decimal text, never as a float.
Empty lines, lines that start with `#`, and a first line of column names are skipped. Every error
names the file and the row (1-based, as an editor counts).
"""

import warnings
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray
from ovmot.text_files import read_text

_NS = 1_000_000_000
_INT64 = 2**63


@dataclass(frozen=True, slots=True)
class StampedTable:
    """A table of a file: stamps (N,) in ns, values (N, K), and the file's row of each (N,).

    `path` may be words for a place that is no file, as a topic of a bag.
    """

    path: Path | str
    timestamp_ns: IntArray
    values: FloatArray
    row: IntArray


@dataclass(frozen=True, slots=True)
class StampedNames:
    """Stamps (N,) in ns, the text beside each (empty where none), and the file's row of each."""

    path: Path
    timestamp_ns: IntArray
    names: tuple[str, ...]
    row: IntArray


def seconds_to_ns(text: str) -> int:
    """Nanoseconds of a decimal number of seconds, exactly; raises `ValueError` for other text."""
    try:
        value = Decimal(text)
        if not abs(value) < _INT64 // _NS:
            raise ValueError("beyond any clock")
        return int((value * _NS).to_integral_value())
    except (ArithmeticError, ValueError):
        raise ValueError(f"'{text}' is not a time in seconds") from None


def ns_to_seconds(timestamp_ns: int) -> str:
    """Seconds with nine decimals, exactly."""
    seconds, rest = divmod(abs(int(timestamp_ns)), _NS)
    return f"{'-' if timestamp_ns < 0 else ''}{seconds}.{rest:09d}"


def read_stamped_csv(path: Path, n_columns: int) -> StampedTable:
    """A comma-separated table: whole nanoseconds, then `n_columns` - 1 finite numbers.

    Raises `DatasetError` naming the first row that is something else.
    """
    lines = read_lines(path, DatasetError)
    layout = np.dtype([("stamp", "i8"), ("values", "f8", (n_columns - 1,))])
    table = lines.parse(layout, n_columns, ",")
    return StampedTable(path, table["stamp"], table["values"], lines.row)


def read_stamped_names(path: Path) -> StampedNames:
    """A list of whole nanoseconds, each with the name of a file after a comma or alone.

    Raises `DatasetError` naming the first row that is something else.
    """
    lines = read_lines(path, DatasetError).with_data()
    stamps, names = [], []
    for row, text in zip(lines.row, lines.text, strict=True):
        stamp, _, name = text.partition(",")
        if not is_stamp(stamp):
            problem = f"'{stamp.strip()[:40]}' is not a stamp in whole nanoseconds"
            raise DatasetError.at(path, problem, "correct or delete the row", row=int(row))
        stamps.append(int(stamp))
        names.append(name.strip())
    return StampedNames(path, np.array(stamps, dtype=np.int64), tuple(names), lines.row)


def column_count(path: Path, delimiter: str | None) -> int:
    """Number of columns of the first row that holds data, 0 for an empty file."""
    lines = read_lines(path, InputError)
    return len(lines.text[0].split(delimiter)) if lines.text else 0


@dataclass(frozen=True, slots=True)
class Lines:
    """The data lines of a text file, and the file's row of each (N,); `error` is raised."""

    path: Path
    error: type[InputError]
    text: list[str]
    row: IntArray

    def with_data(self) -> "Lines":
        """These lines; raises `error` if there are none."""
        if not self.text:
            raise self.error.at(self.path, "holds no data", "is this the right file?")
        return self

    def parse(self, layout: np.dtype[Any], n_columns: int, delimiter: str | None) -> AnyArray:
        """The lines as an array of `layout`, by NumPy's parser; errors name the bad row."""
        self.with_data()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy reads 1.5e18 as an integer, warning only
                table: AnyArray = np.loadtxt(
                    self.text,
                    dtype=layout,
                    delimiter=delimiter,
                    comments=None,
                    ndmin=1 if layout.names else 2,
                )
            if not layout.names and table.shape[1] != n_columns:
                raise ValueError(f"{table.shape[1]} columns")
        except (ValueError, OverflowError, Warning) as error:
            self._complain(n_columns, delimiter, layout.names is not None)
            raise self.error.at(self.path, f"cannot be read: {error}") from None
        numbers = table["values"] if layout.names else table
        broken = ~np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim)))
        if np.any(broken):
            row = int(self.row[int(np.argmax(broken))])
            problem = "holds a number that is not finite"
            raise self.error.at(self.path, problem, "correct or delete the row", row=row)
        return table

    def _complain(self, n_columns: int, delimiter: str | None, stamped: bool) -> None:
        """Raise for the first row that has not `n_columns` numbers; return if there is none."""
        remedy = "correct or delete the row"
        for row, text in zip(self.row, self.text, strict=True):
            fields = text.split(delimiter)
            if len(fields) != n_columns:
                problem = f"{len(fields)} columns where {n_columns} are expected"
                raise self.error.at(self.path, problem, remedy, row=int(row))
            if stamped and not is_stamp(fields[0]):
                problem = f"'{fields[0].strip()[:40]}' is not a stamp in whole nanoseconds"
                raise self.error.at(self.path, problem, remedy, row=int(row))
            for field in fields:
                if not _is_number(field):
                    problem = f"'{field.strip()[:40]}' is not a number"
                    raise self.error.at(self.path, problem, remedy, row=int(row))


def read_lines(path: Path, error: type[InputError]) -> Lines:
    """The lines that hold data: not empty, no comment, no names of columns."""
    everything = read_text(path, error).splitlines()
    rows: list[int] = []
    text: list[str] = []
    header = False
    for row, line in enumerate(everything, start=1):
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        if not text and not header and stripped[0].isalpha() and not _is_number(_first(stripped)):
            header = True
            continue  # names of columns
        rows.append(row)
        text.append(stripped)
    return Lines(path, error, text, np.array(rows, dtype=np.int64))


def _first(line: str) -> str:
    return line.replace(",", " ").split(None, 1)[0]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_stamp(text: str) -> bool:
    """Is this a whole number of nanoseconds?"""
    digits = text.strip().removeprefix("-")
    fits = digits.isascii() and digits.isdigit() and len(digits) <= len(str(_INT64))
    return fits and int(digits) < _INT64


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
