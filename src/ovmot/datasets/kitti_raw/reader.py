"""KITTI raw drives: `sync` (rectified, OXTS at 10 Hz) and `extract` (unrectified, 100 Hz).

A. Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013. Of the OXTS fields the
specific force `ax ay az` and the angular rate `wx wy wz` are used, in the unit's own axes (x
forward, y left, z up), not `af al au` and `wf wl wu`, which are turned to the ground. Position,
orientation and velocity are truth (`kitti_raw_truth`), which no run reads.
"""

from dataclasses import dataclass
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
from ovmot.datasets.kitti_raw.oxts import (
    ACCEL,
    GYRO,
    read_packets,
    read_times,
    stamps_at,
    true_poses,
)
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import IntArray
from ovmot.types import ImuData

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
    stamps = stamps_at(read_times(path), numbers, path)
    backwards = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backwards):
        row = int(numbers[backwards[0] + 1]) + 1
        problem = "the time does not lie after that of the frame before"
        raise DatasetError.at(path, problem, "take the frame's images out", row=row)
    return stamps


def _imu(oxts: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    """The samples of `oxts/data`, None, noted, where there is no such folder."""
    if not (oxts / "data").is_dir():
        note_no_imu(oxts / "data", findings)
        return None
    return checked_imu(read_packets(oxts, findings), GYRO, ACCEL, max_gap_s, findings)


def kitti_raw_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The poses of a drive by its OXTS; None where it has none. Errors as for reading."""
    oxts = _choose(root, sequence).folder / "oxts"
    if not (oxts / "data").is_dir():
        return None
    packets = read_packets(oxts, Findings())
    return true_poses(oxts, packets.timestamp_ns, packets.values)
