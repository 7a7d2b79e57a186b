"""The kinds of data sets: `open_recording` and `open_sequence` open them all.

A new data set is one folder beside this file, with a reader and, where ovmot shall write it too, a
writer, and a line in `DATASETS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ovmot.datasets.bag.file import bag_at
from ovmot.datasets.bag.reader import read_bag
from ovmot.datasets.bag.topics import BagTopics
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.euroc.reader import EurocReader
from ovmot.datasets.euroc.writer import write_asl
from ovmot.datasets.four_seasons.reader import FourSeasonsReader
from ovmot.datasets.four_seasons.writer import write_four_seasons
from ovmot.datasets.kaist.reader import KaistReader
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.kalibr import read_kalibr
from ovmot.datasets.kitti.reader import KittiReader
from ovmot.datasets.kitti_raw.reader import KittiRawReader
from ovmot.datasets.kitti_raw.writer import write_kitti_extract, write_kitti_sync
from ovmot.datasets.sequence import FolderSequence, RecordedSequence
from ovmot.datasets.tum_vi.reader import TumViReader
from ovmot.datasets.tum_vi.writer import write_tum_vi
from ovmot.datasets.uzh_fpv.reader import UzhFpvReader
from ovmot.datasets.uzh_fpv.writer import write_uzh_fpv
from ovmot.datasets.viode.reader import ViodeReader
from ovmot.datasets.viode.writer import write_viode
from ovmot.datasets.writing import Writer
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


@dataclass(frozen=True, slots=True)
class Dataset:
    """A kind of data set: how its folders are read, and the writers of its formats by name."""

    reader: Reader
    writers: Mapping[str, Writer] = field(default_factory=dict)


DATASETS: dict[str, Dataset] = {
    "euroc": Dataset(EurocReader(), {"asl": write_asl}),
    "kaist": Dataset(KaistReader(), {"kaist": write_kaist}),
    "kitti": Dataset(KittiReader()),
    "kitti_raw": Dataset(
        KittiRawReader(), {"kitti_sync": write_kitti_sync, "kitti_extract": write_kitti_extract}
    ),
    "tum_vi": Dataset(TumViReader(), {"tum_vi": write_tum_vi}),
    "viode": Dataset(ViodeReader(), {"viode": write_viode}),
    "uzh_fpv": Dataset(UzhFpvReader(), {"uzh_fpv": write_uzh_fpv}),
    "4seasons": Dataset(FourSeasonsReader(), {"4seasons": write_four_seasons}),
}

WRITERS: dict[str, Writer] = {
    name: write for kind in DATASETS.values() for name, write in kind.writers.items()
}
"""The writers of all data sets by the name of their format."""


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

    `format` is a key of `DATASETS` or None to recognise it; `sequence` chooses where a folder
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
        if format not in DATASETS:
            raise InputError(f"--format {format}: unknown; known: {', '.join(DATASETS)}")
        return DATASETS[format].reader.read(path, sequence, given, gap)
    kinds = recognise(path)
    if not kinds and sequence is not None and len(recognise(path / sequence)) == 1:
        return open_sequence(path / sequence, None, None, given, imu_max_gap_s)
    if len(kinds) != 1:
        what = f"looks like {' and '.join(kinds)}" if kinds else "no known kind of data set"
        known = "; ".join(f"{kind}: {data.reader.needs}" for kind, data in DATASETS.items())
        raise InputError.at(path, what, f"choose with --format. Known: {known}")
    return DATASETS[kinds[0]].reader.read(path, sequence, given, gap)


def recognise(path: Path) -> list[str]:
    """The kinds that a folder looks like."""
    return [kind for kind, data in DATASETS.items() if data.reader.recognise(path)]


def _gap(given_s: float | None) -> float:
    return ImuSettings().max_gap_s if given_s is None else given_s


def _refuse(path: Path, why: str, **options: str | None) -> None:
    """Complain about options that this kind of data does not take."""
    for name, value in options.items():
        if value is not None:
            raise InputError.at(path, why, f"leave out '--{name} {value}'")
