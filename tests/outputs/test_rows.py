from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import InputError, OvmotError
from ovmot.outputs.rows import RowFile, format_rows


@pytest.mark.parametrize(
    ("timestamp_ns", "text"),
    [
        (0, "0.000000000"),
        (1, "0.000000001"),
        (1_403_636_584_763_555_585, "1403636584.763555585"),  # a float would end in ...584
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000000"),
    ],
)
def test_seconds_are_exact(timestamp_ns: int, text: str) -> None:
    assert ns_to_seconds(timestamp_ns) == text


def test_nan_becomes_an_empty_field() -> None:
    rows = [(1, float("nan"), "static"), (2, -float("nan"), ""), (3, float("inf"), "x")]
    assert format_rows("%d,%.2f,%s", rows) == "1,,static\n2,,\n3,inf,x\n"


def test_rows_are_on_disk_before_close(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "a.csv", "head\n")
    file.append("1\n2\n")
    assert (tmp_path / "a.csv").read_text() == "head\n1\n2\n"
    file.close()
    file.close()


def test_full_disk_leaves_whole_rows_and_names_the_file(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = tmp_path / "a.csv"
    file = RowFile(path, "head\n")
    file.append("first,row\n")
    with full_disk(20), pytest.raises(OvmotError, match=r"a\.csv: cannot write any further"):
        file.append("second,row\n")  # 5 of its bytes find room
    assert path.read_text() == "head\nfirst,row\n"
    file.append("third,row\n")  # there is room again: no hole is left
    file.close()
    assert path.read_text() == "head\nfirst,row\nthird,row\n"


def test_interrupt_within_a_row_leaves_whole_rows(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    file = RowFile(path, "head\n")

    class Interrupted:
        """Writes half of what it is given, then Ctrl-C is pressed."""

        def __init__(self, inner: Any) -> None:
            self.inner = inner

        def write(self, data: memoryview) -> int:
            self.inner.write(data[: len(data) // 2])
            raise KeyboardInterrupt

        def __getattr__(self, name: str) -> Any:
            return getattr(self.inner, name)

    file._file = Interrupted(file._file)  # type: ignore[assignment]
    with pytest.raises(KeyboardInterrupt):
        file.append("first,row\n")
    file.close()
    assert path.read_text() == "head\n"


def test_existing_file_is_never_touched(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("old")
    with pytest.raises(InputError, match="--force"):
        RowFile(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "old"


def test_missing_folder_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere/a\.csv: cannot be created"):
        RowFile(tmp_path / "nowhere" / "a.csv")
