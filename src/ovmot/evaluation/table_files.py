"""Tables of a run read back by the names of their columns."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.errors import InputError
from ovmot.geometry.arrays import FloatArray, IntArray

REMEDY = "run it again, or give another run"


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of a file: stamps (N,) in ns, numbers (N, K), and one list of texts for each column."""

    timestamp_ns: IntArray
    values: FloatArray
    texts: dict[str, list[str]]


def read_table(path: Path, columns: tuple[str, ...], texts: tuple[str, ...] = ()) -> Table:
    """The column `timestamp_ns`, the named columns of numbers and those of text.

    An empty field of numbers is NaN. Raises `InputError` with the row of whatever is wrong.
    """
    stamps: list[int] = []
    values: list[list[float]] = []
    found: dict[str, list[str]] = {name: [] for name in texts}
    rows = _rows(path)
    header = next(rows, None)
    if header is None:
        raise InputError.at(path, "is empty", REMEDY)
    missing = [name for name in ("timestamp_ns", *columns, *texts) if name not in header]
    if missing:
        raise InputError.at(path, f"has no column '{missing[0]}'", REMEDY, row=1)
    at = header.index("timestamp_ns")
    where = [header.index(name) for name in columns]
    where_text = {name: header.index(name) for name in texts}
    for number, fields in enumerate(rows, start=2):
        if len(fields) != len(header):
            problem = f"{len(fields)} columns where {len(header)} are expected"
            raise InputError.at(path, problem, REMEDY, row=number)
        try:
            stamps.append(int(fields[at]))
            values.append([float(fields[k] or "nan") for k in where])
        except ValueError as error:
            raise InputError.at(path, f"is not a number: {error}", REMEDY, row=number) from None
        for name, k in where_text.items():
            found[name].append(fields[k])
    array = np.array(values, dtype=np.float64).reshape(-1, len(columns))
    return Table(np.array(stamps, dtype=np.int64), array, found)


def _rows(path: Path) -> Iterator[list[str]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            yield from csv.reader(file)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError.at(path, f"cannot be read as a table: {error}", REMEDY) from None
