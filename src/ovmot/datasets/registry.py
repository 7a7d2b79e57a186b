"""The kinds of data sets: `open_recording` and `open_sequence` open them all.

A new data set is one folder beside this file, with a reader and, where ovmot shall write it too, a
writer, and a line in `DATASETS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from ovmot.datasets.given_calibration import read_calibration
from ovmot.datasets.kaist.reader import KaistReader
from ovmot.datasets.kaist.writer import write_kaist
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
from ovmot.text_files import StrPath


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
    path: StrPath,
    format: str | None = None,
    sequence: str | None = None,
    calibration: StrPath | Calibration | None = None,
    imu_max_gap_s: float | None = None,
    topics: BagTopics | None = None,
) -> RecordedSequence:
    """Describe a recorded sequence in a folder or a ROS bag; no image is decoded yet.

    Parameters
    ----------
    path
        The folder of a sequence, or a bag: `.bag`, `.mcap`, `.db3` or the folder of a ROS 2 bag.
    format
        A key of `DATASETS`; None to recognise it by what the folder holds.
    sequence
        Which one, where the folder holds several.
    calibration
        A Kalibr chain (a file, or a folder with one), a rig's file of VINS, or a value, in place of
        the data's own.
    imu_max_gap_s
        The setting `imu.max_gap_s`: a longer hole in the IMU's samples is reported.
    topics
        Those of a bag, where they cannot be found by their types; `left` and `right` may also be
        cameras of a chain of more than two.

    Returns
    -------
    RecordedSequence
        It has `rig` and `imu_noise`; iterated over, it gives IMU samples and stereo frames in an
        order that `Odometry.add` takes.

    Raises
    ------
    InputError
        Or a child of it: one line with file, row and remedy.
    """
    root, given = Path(path), _as_calibration(calibration)
    bag = bag_at(root)
    if bag is None:
        asked = topics or BagTopics()
        _refuse(root, "is no bag", imu=asked.imu)
        if isinstance(given, Path):
            given = read_calibration(given, asked.left, asked.right)
        known = () if given is None else (*given.cameras, *given.topics)
        if not {asked.left, asked.right} <= {*known, None}:
            _refuse(root, "is no bag", left=asked.left, right=asked.right)
        return open_sequence(root, format, sequence, given, imu_max_gap_s)
    _refuse(root, "is a bag", format=format, sequence=sequence)
    return read_bag(bag, topics or BagTopics(), given, _gap(imu_max_gap_s))


def open_sequence(
    path: StrPath,
    format: str | None = None,
    sequence: str | None = None,
    calibration: StrPath | Calibration | None = None,
    imu_max_gap_s: float | None = None,
) -> FolderSequence:
    """Describe the sequence in a folder; arguments and errors as for `open_recording`."""
    root = Path(path)
    if not root.exists():
        raise InputError.at(root, "no such folder or bag", _GIVE)
    if not root.is_dir():
        raise InputError.at(root, "not a folder, and not a bag", _GIVE)
    chain = _as_calibration(calibration)
    given = read_calibration(chain) if isinstance(chain, Path) else chain
    if given is not None and given.note is not None:
        opened = open_sequence(root, format, sequence, replace(given, note=None), imu_max_gap_s)
        return replace(opened, warnings=(given.note, *opened.warnings))
    gap = _gap(imu_max_gap_s)
    if format is not None:
        if format not in DATASETS:
            raise InputError(f"--format {format}: unknown; known: {', '.join(DATASETS)}")
        return DATASETS[format].reader.read(root, sequence, given, gap)
    kinds = recognise(root)
    if not kinds and sequence is not None and len(recognise(root / sequence)) == 1:
        return open_sequence(root / sequence, None, None, given, imu_max_gap_s)
    if len(kinds) != 1:
        what = f"looks like {' and '.join(kinds)}" if kinds else "no known kind of data set"
        known = "; ".join(f"{kind}: {data.reader.needs}" for kind, data in DATASETS.items())
        raise InputError.at(root, what, f"choose with --format. Known: {known}")
    return DATASETS[kinds[0]].reader.read(root, sequence, given, gap)


def recognise(path: Path) -> list[str]:
    """The kinds that a folder looks like."""
    return [kind for kind, data in DATASETS.items() if data.reader.recognise(path)]


def _as_calibration(given: StrPath | Calibration | None) -> Path | Calibration | None:
    return given if given is None or isinstance(given, Calibration) else Path(given)


def _gap(given_s: float | None) -> float:
    return ImuSettings().max_gap_s if given_s is None else given_s


def _refuse(path: Path, why: str, **options: str | None) -> None:
    """Complain about options that this kind of data does not take."""
    for name, value in options.items():
        if value is not None:
            raise InputError.at(path, why, f"leave out '--{name} {value}'")
