"""The kinds of data sets, and the one door to them. A new kind: one file and a line here."""

from pathlib import Path
from typing import Protocol

from ovmot.cameras.calibration import Calibration
from ovmot.cameras.kalibr import read_kalibr
from ovmot.config import ImuSettings
from ovmot.datasets.euroc import EurocReader
from ovmot.datasets.four_seasons import FourSeasonsReader
from ovmot.datasets.kaist import KaistReader
from ovmot.datasets.kitti import KittiReader
from ovmot.datasets.kitti_raw import KittiRawReader
from ovmot.datasets.sequence import FolderSequence
from ovmot.datasets.tum_vi import TumViReader
from ovmot.datasets.uzh_fpv import UzhFpvReader
from ovmot.datasets.viode import ViodeReader
from ovmot.errors import InputError


class Reader(Protocol):
    """Reads one kind of folder; `needs` says in words what it must hold."""

    needs: str

    def recognise(self, root: Path) -> bool:
        """Does this folder look like this kind?"""
        ...

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        imu_max_gap_s: float,
    ) -> FolderSequence:
        """Describe a sequence, with the folder's own calibration unless one is given."""
        ...


READERS: dict[str, Reader] = {
    "euroc": EurocReader(),
    "kaist": KaistReader(),
    "kitti": KittiReader(),
    "kitti_raw": KittiRawReader(),
    "tum_vi": TumViReader(),
    "viode": ViodeReader(),
    "uzh_fpv": UzhFpvReader(),
    "4seasons": FourSeasonsReader(),
}


def open_sequence(
    path: Path,
    format: str | None = None,
    sequence: str | None = None,
    calibration: Path | Calibration | None = None,
    imu_max_gap_s: float | None = None,
) -> FolderSequence:
    """Describe the sequence in a folder; no image is decoded.

    `format` is a key of `READERS` or None to recognise it; `sequence` chooses where a folder
    holds several; `calibration`, or a Kalibr chain file or folder with one, is in place of the data
    set's own; `imu_max_gap_s` is the setting `imu.max_gap_s`.
    Raises `InputError` and its children, each with file, row and remedy.
    """
    if not path.exists():
        raise InputError.at(path, "no such folder", "give the folder of a recorded sequence")
    if not path.is_dir():
        raise InputError.at(path, "not a folder", "give the folder of a recorded sequence")
    given = read_kalibr(calibration) if isinstance(calibration, Path) else calibration
    gap = ImuSettings().max_gap_s if imu_max_gap_s is None else imu_max_gap_s
    if format is not None:
        if format not in READERS:
            raise InputError(f"--format {format}: unknown; known: {', '.join(READERS)}")
        return READERS[format].read(path, sequence, given, gap)
    kinds = recognise(path)
    if not kinds and sequence is not None and len(recognise(path / sequence)) == 1:
        return open_sequence(path / sequence, None, None, given, imu_max_gap_s)
    if len(kinds) != 1:
        what = f"looks like {' and '.join(kinds)}" if kinds else "no known kind of data set"
        known = "; ".join(f"{kind}: {reader.needs}" for kind, reader in READERS.items())
        raise InputError.at(path, what, f"choose with --format. Known: {known}")
    return READERS[kinds[0]].read(path, sequence, given, gap)


def recognise(path: Path) -> list[str]:
    """The kinds that a folder looks like."""
    return [kind for kind, reader in READERS.items() if reader.recognise(path)]
