"""KITTI raw drives: `sync` (rectified, OXTS at 10 Hz) and `extract` (unrectified, 100 Hz).

A. Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013. Of the OXTS fields the
specific force `ax ay az` and the angular rate `wx wy wz` are used, in the unit's own axes (x
forward, y left, z up), not `af al au` and `wf wl wu`, which are turned to the ground. Position,
orientation and velocity are truth, and not read.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, note_no_imu
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    camera_images,
    numbered_images,
    pair_images,
)
from ovmot.datasets.images import image_size, read_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.kitti_raw.calibration import CAMERAS_FILE, read_kitti_raw_calibration
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import StampedTable
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.text_files import read_text
from ovmot.types import ImuData

_FIELDS = 30
_ACCEL, _GYRO = 11, 17  # ax ay az, wx wy wz
_NO_STAMP = -1
_DENSE = 3  # samples an image: `_sync` has 1, `_extract` 10


@dataclass(frozen=True, slots=True)
class _Drive:
    """A drive's folder and the number of its left camera: 0 (grey), else 2 (colour)."""

    folder: Path
    left: int

    @property
    def cameras(self) -> tuple[Path, Path]:
        return self.folder / f"image_{self.left:02d}", self.folder / f"image_{self.left + 1:02d}"


class KittiRawReader:
    """Reads a drive, or a date's folder with several of them."""

    needs = (
        "<date>/<date>_drive_<number>_sync|_extract with image_00, image_01 (or 02, 03), oxts;"
        " calib_cam_to_cam.txt, calib_velo_to_cam.txt, calib_imu_to_velo.txt in <date>"
    )

    def recognise(self, root: Path) -> bool:
        return _drive(root) is not None or bool(_drives_below(root))

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the drive; raises `InputError` and its children for what is wrong."""
        drive = _choose(root, sequence)
        findings = Findings()
        left, right = (
            camera_images(partial(numbered_images, camera / "data"), limits, findings)
            for camera in drive.cameras
        )
        listing = pair_images(left, right, drive.folder, findings, limits.by_number)
        imu = _imu(drive.folder / "oxts", limits.imu_max_gap_s, findings)
        found = calibration or _calibration(drive, listing)
        times = partial(_frame_stamps, drive.cameras[0] / "timestamps.txt")
        return assemble(
            kind="kitti_raw",
            name=drive.folder.resolve().name,
            root=root,
            calibration=found,
            listing=listing.stamped(times),
            imu=imu,
            decode=read_grey,
            findings=findings,
            numbers=listing.frame_ns,
        )


def has_sparse_imu(root: Path, sequence: str | None) -> bool:
    """Is the IMU of a drive recorded at the rate of its images, as in the `_sync` form?

    Raises `InputError` where `sequence` names none of several drives.
    """
    drive = _choose(root, sequence)
    packets, images = (drive.folder / "oxts" / "data", drive.cameras[0] / "data")
    n_packets, n_images = (
        sum(1 for _ in f.iterdir()) if f.is_dir() else 0 for f in (packets, images)
    )
    return 0 < n_packets < _DENSE * n_images


def _choose(root: Path, sequence: str | None) -> _Drive:
    drive = _drive(root)
    if drive is not None:
        if sequence is not None:
            remedy = f"leave out '--sequence {sequence}'"
            raise InputError.at(root, "holds one drive", remedy)
        return drive
    drives = _drives_below(root)
    known = f"there are: {', '.join(drives)}" if drives else f"it needs {KittiRawReader.needs}"
    if sequence is not None and sequence in drives:
        return drives[sequence]
    if sequence is not None:
        raise InputError.at(root, f"no drive '{sequence}'", known)
    if len(drives) != 1:
        problem = f"{len(drives)} drives" if drives else "not a KITTI raw folder"
        raise InputError.at(root, problem, f"choose one with --sequence; {known}")
    return next(iter(drives.values()))


def _drive(folder: Path) -> _Drive | None:
    lefts = (i for i in (0, 2) if (folder / f"image_{i:02d}" / "data").is_dir())
    left = next(lefts, None)
    return None if left is None else _Drive(folder, left)


def _drives_below(root: Path) -> dict[str, _Drive]:
    """Drives in a date's folder, or in the folders of several dates, by name."""
    folders = sorted([*root.glob("*_drive_*"), *root.glob("*/*_drive_*")])
    found = ((folder.name, _drive(folder)) for folder in folders)
    return {name: drive for name, drive in found if drive is not None}


def _calibration(drive: _Drive, listing: StereoListing) -> Calibration:
    """From the date's folder, or the drive's own where the files were copied there."""
    folder = drive.folder.resolve()
    place = folder if (folder / CAMERAS_FILE).exists() else folder.parent
    size = image_size(listing.any_path)
    rectified = {"sync": True, "extract": False}.get(folder.name.rpartition("_")[2])
    return read_kitti_raw_calibration(place, drive.left, size, rectified)


def _frame_stamps(path: Path, numbers: IntArray) -> IntArray:
    """Stamps (M,) in ns of the frames of these numbers (M,)."""
    stamps = _at(_read_times(path), numbers, path)
    backwards = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backwards):
        row = int(numbers[backwards[0] + 1]) + 1
        problem = "the time does not lie after that of the frame before"
        raise DatasetError.at(path, problem, "take the frame's images out", row=row)
    return stamps


def _read_times(path: Path) -> IntArray:
    """Nanoseconds of each row `2011-09-26 13:02:25.964389445`; -1 for an empty one."""
    missing = "no such file; it holds the time of each file"
    lines = read_text(path, DatasetError, missing).split("\n")
    stamps = np.full(len(lines), _NO_STAMP, dtype=np.int64)
    for i, line in enumerate(lines):
        text = line.strip()
        if not text:
            continue
        try:
            stamps[i] = _time_ns(text)
        except ValueError:
            remedy = "a row is: year-month-day hour:minute:second.fraction"
            raise DatasetError.at(path, f"'{text[:40]}' is no time", remedy, row=i + 1) from None
    return stamps


def _time_ns(text: str) -> int:
    """Nanoseconds since 1970 of a date and time taken as UTC."""
    whole, _, fraction = text.partition(".")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    if fraction and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(text)
    return int(moment.timestamp()) * 10**9 + int(fraction[:9].ljust(9, "0"))


def _at(stamps: IntArray, numbers: IntArray, path: Path) -> IntArray:
    """The stamps of numbered files; raises `DatasetError` for a file without one."""
    known = np.append(stamps, _NO_STAMP)[np.minimum(numbers, len(stamps))]
    if np.any(known == _NO_STAMP):
        number = int(numbers[int(np.argmax(known == _NO_STAMP))])
        problem = f"no time for the file of number {number}"
        raise DatasetError.at(path, problem, "row n is the time of file n - 1", row=number + 1)
    return known


def _imu(oxts: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    """The samples of `oxts/data`; those that do not lie after all before them are dropped.

    Some `extract` drives have packets out of order: their stamps are the receiver's.
    """
    if not (oxts / "data").is_dir():
        note_no_imu(oxts / "data", findings)
        return None
    files = {int(p.stem): p for p in (oxts / "data").glob("*.txt") if p.stem.isdigit()}
    if not files:
        raise DatasetError.at(oxts / "data", "no samples in this folder", "copy it again")
    numbers = np.array(sorted(files), dtype=np.int64)
    stamps = _at(_read_times(oxts / "timestamps.txt"), numbers, oxts / "timestamps.txt")
    latest = np.maximum.accumulate(stamps)
    fresh = np.concatenate([[True], stamps[1:] > latest[:-1]])
    late = int(np.count_nonzero(~fresh))
    text = f"{oxts}: {late} samples that do not lie after the one before: dropped"
    findings.note("imu_out_of_order", late, text)
    values = np.array([_fields(files[int(n)]) for n in numbers[fresh]])
    table = StampedTable(oxts / "timestamps.txt", stamps[fresh], values, numbers[fresh] + 1)
    return checked_imu(table, _GYRO, _ACCEL, max_gap_s, findings)


def _fields(path: Path) -> FloatArray:
    """The 30 numbers of one OXTS packet."""
    try:
        values = np.array(read_text(path, DatasetError).split(), dtype=np.float64)
    except ValueError as error:
        raise DatasetError.at(path, f"cannot be read: {error}", "copy it again") from None
    if len(values) != _FIELDS or not np.all(np.isfinite(values)):
        problem = f"{len(values)} numbers where {_FIELDS} finite ones are expected"
        raise DatasetError.at(path, problem, "copy it again")
    return values
