"""What a reader notices while it reads: warnings for the user and counts for `run.json`.

The notes and refusals that several readers share stand here too."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import BoolArray, IntArray

_TWICE = {"imu": "imu_duplicates", "frames": "duplicate_frames"}
_LATE = {"imu": "imu_rows_out_of_order", "frames": "frame_rows_out_of_order"}


@dataclass(slots=True)
class Findings:
    """Collects counted warnings; a count of 0 leaves no trace."""

    warnings: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def note(self, key: str, count: int, text: str) -> None:
        """Add `count` under `key`, and its sentence, if there is anything to say."""
        if count:
            self.warnings.append(text)
            self.counts[key] = self.counts.get(key, 0) + count


def rising(
    timestamp_ns: IntArray, row: IntArray, path: Path | str, kind: str, findings: Findings
) -> BoolArray:
    """Which stamps (N,) are later than all before them; the others are counted by `kind`.

    `row` (N,) are the rows of `path`; `kind` is "imu" or "frames". A stamp that comes twice is
    counted as a duplicate, one that is late or comes after the clock was set back as out of order.
    Raises `DatasetError` where more than half of the stamps do not rise.
    """
    newest = np.maximum.accumulate(timestamp_ns)
    fresh = np.concatenate([[True], timestamp_ns[1:] > newest[:-1]])
    twice = ~fresh & np.isin(timestamp_ns, timestamp_ns[fresh])
    late = ~fresh & ~twice
    if 2 * np.count_nonzero(fresh) < len(fresh):
        problem = "most stamps do not follow those above, the first in this row"
        first = int(row[int(np.argmin(fresh))])
        raise DatasetError.at(path, problem, "sort the file by time", row=first)
    n_twice, n_late = int(np.count_nonzero(twice)), int(np.count_nonzero(late))
    text = f"{path}: {n_twice} rows of {kind} with a stamp that came before: dropped"
    findings.note(_TWICE[kind], n_twice, text)
    if n_late:
        first = int(row[int(np.argmax(late))])
        text = (
            f"{path}: {n_late} rows of {kind} with a stamp before one above, the first is row"
            f" {first}: dropped; where the clock was set back, the position may jump"
        )
        findings.note(_LATE[kind], n_late, text)
    return fresh


def note_no_imu(path: Path, findings: Findings) -> None:
    """Note that the IMU's file is missing."""
    findings.note("no_imu", 1, f"{path}: no IMU file; the ego motion must come from poses")


def note_no_imu_noise(path: Path, findings: Findings) -> None:
    """Note that the file with the IMU's noise is missing."""
    findings.note("no_imu_noise", 1, f"{path}: missing; the IMU noise of the settings is used")


def refuse_choice(root: Path, sequence: str | None) -> None:
    """Raise `InputError` where `--sequence` is given for a folder of one sequence."""
    if sequence is not None:
        raise InputError.at(root, "holds one sequence", f"leave out '--sequence {sequence}'")
