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
from ovmot.datasets.frames import ReadingLimits
from ovmot.datasets.given_calibration import read_calibration
from ovmot.datasets.kaist.reader import KaistReader
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.kalibr import CHAIN_FILE
from ovmot.datasets.kitti.reader import KittiReader
from ovmot.datasets.kitti_raw.reader import KittiRawReader, has_sparse_imu
from ovmot.datasets.kitti_raw.writer import write_kitti_extract, write_kitti_sync
from ovmot.datasets.presets import Preset, shipped_preset
from ovmot.datasets.sequence import FolderSequence, RecordedSequence
from ovmot.datasets.tum_vi.reader import TumViReader
from ovmot.datasets.tum_vi.writer import write_tum_vi
from ovmot.datasets.uzh_fpv.reader import UzhFpvReader
from ovmot.datasets.uzh_fpv.writer import write_uzh_fpv
from ovmot.datasets.viode.reader import ViodeReader
from ovmot.datasets.viode.writer import write_viode
from ovmot.datasets.writing import Writer
from ovmot.errors import InputError
from ovmot.settings import Settings
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
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe a sequence, with the folder's own calibration unless one is given."""
        ...


_GIVE = "give the folder of a recorded sequence, or a ROS bag (.bag, .mcap, .db3)"


@dataclass(frozen=True, slots=True)
class Dataset:
    """A kind of data set: how its folders are read, the writers of its formats by name, and the
    settings that it wants."""

    reader: Reader
    writers: Mapping[str, Writer] = field(default_factory=dict)
    preset: Preset | None = None


DATASETS: dict[str, Dataset] = {
    "euroc": Dataset(EurocReader(), {"asl": write_asl}),
    "kaist": Dataset(KaistReader(), {"kaist": write_kaist}),
    "kitti": Dataset(KittiReader()),
    "kitti_raw": Dataset(
        KittiRawReader(),
        {"kitti_sync": write_kitti_sync, "kitti_extract": write_kitti_extract},
        shipped_preset("kitti_raw", "kitti_raw", has_sparse_imu),
    ),
    "tum_vi": Dataset(TumViReader(), {"tum_vi": write_tum_vi}),
    "viode": Dataset(ViodeReader(), {"viode": write_viode}, shipped_preset("viode", "viode")),
    "uzh_fpv": Dataset(UzhFpvReader(), {"uzh_fpv": write_uzh_fpv}),
    "4seasons": Dataset(FourSeasonsReader(), {"4seasons": write_four_seasons}),
}

WRITERS: dict[str, Writer] = {
    name: write for kind in DATASETS.values() for name, write in kind.writers.items()
}
"""The writers of all data sets by the name of their format."""

PRESETS: dict[str, Preset] = {
    name: kind.preset for name, kind in DATASETS.items() if kind.preset is not None
}
"""The presets of all data sets by the name of the format."""


def open_recording(
    path: StrPath,
    format: str | None = None,
    sequence: str | None = None,
    calibration: StrPath | Calibration | None = None,
    imu_max_gap_s: float | None = None,
    topics: BagTopics | None = None,
    pair_tolerance_s: float | None = None,
    need_imu_pose: bool = True,
    need_pairs: bool = True,
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
        A Kalibr chain (a file, or a folder with one), a rig's file of VINS, the folder of a data
        set, or a value, in place of the data's own.
    imu_max_gap_s
        The setting `imu.max_gap_s`: a longer hole in the IMU's samples is reported. None for the
        preset's, else the default.
    topics
        Those of a bag, where they cannot be found by their types; `left` and `right` may also be
        cameras of a chain of more than two.
    pair_tolerance_s
        The setting `recording.pair_tolerance_s`: so far apart may a pair's stamps be.
    need_imu_pose
        Whether a Kalibr chain must say where the cameras are on the IMU; else the left camera
        stands for the IMU, for poses that are given.
    need_pairs
        Whether a folder without images of one camera is an error; else all its frames are without
        that picture.

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
            given = read_calibration(given, asked.left, asked.right, need_imu_pose)
        known = () if given is None else (*given.cameras, *given.topics)
        if not {asked.left, asked.right} <= {*known, None}:
            _refuse(root, "is no bag", left=asked.left, right=asked.right)
        return open_sequence(
            root,
            format,
            sequence,
            given,
            imu_max_gap_s,
            pair_tolerance_s,
            need_imu_pose,
            need_pairs,
        )
    _refuse(root, "is a bag", format=format, sequence=sequence)
    limits = replace(_limits(imu_max_gap_s, pair_tolerance_s), need_imu_pose=need_imu_pose)
    return read_bag(bag, topics or BagTopics(), given, limits)


def open_sequence(
    path: StrPath,
    format: str | None = None,
    sequence: str | None = None,
    calibration: StrPath | Calibration | None = None,
    imu_max_gap_s: float | None = None,
    pair_tolerance_s: float | None = None,
    need_imu_pose: bool = True,
    need_pairs: bool = True,
) -> FolderSequence:
    """Describe the sequence in a folder; arguments and errors as for `open_recording`."""
    root = Path(path)
    if not root.exists():
        raise InputError.at(root, "no such folder or bag", _GIVE)
    if not root.is_dir():
        raise InputError.at(root, "not a folder, and not a bag", _GIVE)
    chain = _as_calibration(calibration)
    if isinstance(chain, Path):
        chain = read_calibration(chain, need_imu_pose=need_imu_pose)
    limits = replace(
        _limits(imu_max_gap_s, pair_tolerance_s), need_pairs=need_pairs, need_imu_pose=need_imu_pose
    )
    if format is not None:
        if format not in DATASETS:
            raise InputError(f"--format {format}: unknown; known: {', '.join(DATASETS)}")
        return _read(format, root, sequence, chain, limits, imu_max_gap_s)
    kinds = recognise(root)
    if not kinds and sequence is not None and len(recognise(root / sequence)) == 1:
        root, sequence = root / sequence, None
        kinds = recognise(root)
    if len(kinds) != 1:
        if kinds:
            what = f"looks like {' and '.join(kinds)}"
            raise InputError.at(root, what, "choose with --format")
        remedy = f"name it by --format to be told what is missing: {', '.join(DATASETS)}"
        raise InputError.at(root, "no known kind of data set", remedy)
    return _read(kinds[0], root, sequence, chain, limits, imu_max_gap_s)


def _read(
    kind: str,
    root: Path,
    sequence: str | None,
    calibration: Calibration | None,
    limits: ReadingLimits,
    given_max_gap_s: float | None,
) -> FolderSequence:
    """The sequence with its preset; a noise of the IMU that the calibration says overrules it."""
    data = DATASETS[kind]
    preset = data.preset if data.preset and data.preset.serves(root, sequence) else None
    if given_max_gap_s is None and preset is not None:
        limits = replace(limits, imu_max_gap_s=preset.under(Settings()).imu.max_gap_s)
    found = data.reader.read(root, sequence, calibration, limits)
    if preset is not None and found.imu_noise is not None:
        preset = preset.without_noise()
    return replace(found, preset=preset)


def recognise(path: Path) -> list[str]:
    """The kinds that a folder looks like."""
    return [kind for kind, data in DATASETS.items() if data.reader.recognise(path)]


def _as_calibration(given: StrPath | Calibration | None) -> Path | Calibration | None:
    """A data set's folder as its own calibration; what else is given is a chain."""
    if given is None or isinstance(given, Calibration):
        return given
    path = Path(given)
    if not path.is_dir() or (path / CHAIN_FILE).exists() or not recognise(path):
        return path
    sequence = open_sequence(path)
    return Calibration.of_rig(sequence.rig, sequence.imu_noise)


def _limits(imu_max_gap_s: float | None, pair_tolerance_s: float | None) -> ReadingLimits:
    """The limits that are given, the defaults for those that are not."""
    limits = ReadingLimits()
    if imu_max_gap_s is not None:
        limits = replace(limits, imu_max_gap_s=imu_max_gap_s)
    if pair_tolerance_s is not None:
        limits = replace(limits, pair_tolerance_s=pair_tolerance_s)
    return limits


def _refuse(path: Path, why: str, **options: str | None) -> None:
    """Complain about options that this kind of data does not take."""
    for name, value in options.items():
        if value is not None:
            raise InputError.at(path, why, f"leave out '--{name} {value}'")
