"""The kinds of data sets, and the one door to them. A new kind: one file and a line here."""

from pathlib import Path
from typing import Protocol

from ovmot.datasets.bag.file import bag_at
from ovmot.datasets.bag.reader import read_bag
from ovmot.datasets.bag.topics import BagTopics
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.euroc.reader import EurocReader
from ovmot.datasets.four_seasons.reader import FourSeasonsReader
from ovmot.datasets.kaist.reader import KaistReader
from ovmot.datasets.kalibr import read_kalibr
from ovmot.datasets.kitti.reader import KittiReader
from ovmot.datasets.kitti_raw.reader import KittiRawReader
from ovmot.datasets.sequence import FolderSequence, RecordedSequence
from ovmot.datasets.tum_vi.reader import TumViReader
from ovmot.datasets.uzh_fpv.reader import UzhFpvReader
from ovmot.datasets.viode.reader import ViodeReader
from ovmot.errors import InputError
from ovmot.settings import ImuSettings


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


_GIVE = "give the folder of a recorded sequence, or a ROS bag (.bag, .mcap, .db3)"

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


def open_recording(
    path: Path,
    format: str | None = None,
    sequence: str | None = None,
    calibration: Path | Calibration | None = None,
    imu_max_gap_s: float | None = None,
    topics: BagTopics | None = None,
) -> RecordedSequence:
    """Describe the sequence in a ROS bag or, as `open_sequence` does, in a folder.

    `topics` are those of a bag, which has neither format nor several sequences.
    """
    bag = bag_at(path)
    if bag is None:
        if topics is not None:
            _refuse(path, "is no bag", left=topics.left, right=topics.right, imu=topics.imu)
        return open_sequence(path, format, sequence, calibration, imu_max_gap_s)
    _refuse(path, "is a bag", format=format, sequence=sequence)
    return read_bag(bag, topics or BagTopics(), calibration, _gap(imu_max_gap_s))


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
        raise InputError.at(path, "no such folder or bag", _GIVE)
    if not path.is_dir():
        raise InputError.at(path, "not a folder, and not a bag", _GIVE)
    given = read_kalibr(calibration) if isinstance(calibration, Path) else calibration
    gap = _gap(imu_max_gap_s)
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


def _gap(given_s: float | None) -> float:
    return ImuSettings().max_gap_s if given_s is None else given_s


def _refuse(path: Path, why: str, **options: str | None) -> None:
    """Complain about options that this kind of data does not take."""
    for name, value in options.items():
        if value is not None:
            raise InputError.at(path, why, f"leave out '--{name} {value}'")
