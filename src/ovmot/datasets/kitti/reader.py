"""KITTI image folders: tracking (`image_02/0010`) and odometry (`sequences/00/image_0`)."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import ReadingLimits, camera_images, numbered_images, pair_images
from ovmot.datasets.images import image_size, read_grey
from ovmot.datasets.kitti.calibration import read_kitti_calibration
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import seconds_to_ns
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import IntArray
from ovmot.text_files import read_text

_TRACKING_PERIOD_NS = 100_000_000  # tracking has no stamps: 10 Hz from zero


@dataclass(frozen=True, slots=True)
class Layout:
    """Where one sequence's files are; `left` is the number of the left camera.

    `folder` holds all sequences of tracking, or one of odometry, the one with `times`.
    """

    name: str
    folder: Path
    images: tuple[Path, Path]
    calibration: Path
    left: int
    times: Path | None


class KittiReader:
    """Reads KITTI tracking and odometry; neither has an IMU that is fast enough to be used."""

    needs = (
        "tracking: image_02/<sequence>, image_03/<sequence>, calib/<sequence>.txt;"
        " odometry: sequences/<sequence>/image_0, image_1, calib.txt, times.txt"
    )

    def recognise(self, root: Path) -> bool:
        return _tracking(root) is not None or _odometry(root) is not None

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        layout = layout_of(root, sequence)
        findings = Findings()
        left, right = (
            camera_images(partial(numbered_images, folder), limits, findings)
            for folder in layout.images
        )
        listing = pair_images(left, right, layout.images[0].parent, findings, limits.by_number)
        size = image_size(listing.any_path)
        found = calibration or read_kitti_calibration(layout.calibration, layout.left, size)
        return assemble(
            kind="kitti",
            name=layout.name,
            root=root,
            calibration=found,
            listing=listing.stamped(partial(frame_stamps, layout)),
            imu=None,
            decode=read_grey,
            findings=findings,
            numbers=listing.frame_ns,
        )


def layout_of(root: Path, sequence: str | None) -> Layout:
    """Where the files of the chosen sequence are; raises `InputError`."""
    tracking, odometry = _tracking(root), _odometry(root)
    if tracking is not None:
        name = _choose(tracking / "image_02", sequence)
        images = tracking / "image_02" / name, tracking / "image_03" / name
        return Layout(name, tracking, images, tracking / "calib" / f"{name}.txt", 2, None)
    if odometry is None:
        raise InputError.at(root, "not a KITTI folder", f"it needs {KittiReader.needs}")
    if odometry.name == "sequences" and not _is_odometry(odometry):
        odometry = odometry / _choose(odometry, sequence)
    elif sequence is not None:
        raise InputError.at(root, "holds one sequence", f"leave out '--sequence {sequence}'")
    left = 0 if (odometry / "image_0").is_dir() else 2
    images = odometry / f"image_{left}", odometry / f"image_{left + 1}"
    times, calibration = odometry / "times.txt", odometry / "calib.txt"
    return Layout(odometry.resolve().name, odometry, images, calibration, left, times)


def _tracking(root: Path) -> Path | None:
    for folder in (root, root / "training", root / "testing"):
        # a raw drive has folders of that name too, with the images in `data`
        if (folder / "image_02").is_dir() and not (folder / "image_02" / "data").is_dir():
            return folder
    return None


def _odometry(root: Path) -> Path | None:
    if _is_odometry(root):
        return root
    folders = (root, root / "sequences", root / "dataset" / "sequences")
    return next((f for f in folders if f.name == "sequences" and f.is_dir()), None)


def _is_odometry(folder: Path) -> bool:
    return (folder / "image_0").is_dir() or (folder / "image_2").is_dir()


def _choose(folder: Path, sequence: str | None) -> str:
    """The one sequence in a folder, or the one asked for."""
    names = sorted(p.name for p in folder.iterdir() if p.is_dir())
    known = f"there are: {', '.join(names)}" if names else "unpack a sequence here"
    if sequence is not None:
        if sequence not in names:
            raise InputError.at(folder, f"no sequence '{sequence}'", known)
        return sequence
    if len(names) != 1:
        problem = f"{len(names)} sequences" if names else "no sequence"
        raise InputError.at(folder, problem, f"choose one with --sequence; {known}")
    return names[0]


def frame_stamps(layout: Layout, frame_numbers: IntArray) -> IntArray:
    """Stamps (M,) in ns of the frames of a sequence by their numbers (M,)."""
    return _stamps(layout.times, frame_numbers)


def _stamps(times: Path | None, frame_numbers: IntArray) -> IntArray:
    """Stamps (M,) in ns of frame numbers (M,): a row of `times.txt` each, or 10 Hz from zero."""
    if times is None:
        return frame_numbers * _TRACKING_PERIOD_NS
    missing = "no such file; it holds each frame's time"
    lines = read_text(times, DatasetError, missing).split("\n")
    stamps: list[int] = []
    for row, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            stamps.append(seconds_to_ns(line.strip()))
        except ValueError as error:
            raise DatasetError.at(times, str(error), "one time a row", row=row) from None
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            problem = "the time does not lie after that of the row above"
            raise DatasetError.at(times, problem, "times rise from row to row", row=row)
    last = int(frame_numbers.max(initial=-1))
    if last >= len(stamps):
        problem = f"{len(stamps)} times, but an image of number {last}"
        raise DatasetError.at(times, problem, "it needs a row for each frame")
    return np.array(stamps, dtype=np.int64)[frame_numbers]
