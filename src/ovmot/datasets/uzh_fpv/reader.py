"""UZH-FPV folders: lists of stereo images and of IMU samples, with times in seconds.

J. Delmerico et al., "Are we ready for autonomous drone racing? The UZH-FPV drone racing dataset",
ICRA 2019. The calibration is a separate download: its Kalibr files are looked for in the
sequence's folder, in folders there whose name holds `calib`, and likewise one folder up.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise, refuse_choice
from ovmot.datasets.frames import (
    NoImagesError,
    ReadingLimits,
    StereoListing,
    camera_images,
    checked_stamps,
    note_missing_images,
    pair_images,
)
from ovmot.datasets.images import read_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.kalibr import CHAIN_FILE, IMU_FILE, read_kalibr_cameras, read_kalibr_noise
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import column_count, read_timed_names, read_timed_text
from ovmot.errors import CalibrationError, DatasetError, InputError
from ovmot.types import ImuData

_LISTS = "left_images.txt", "right_images.txt"
_CHAINS = (CHAIN_FILE, "camchain-imucam*.yaml", "camchain*.yaml")
_NOISES = (IMU_FILE, "imu*.yaml")
_IMU_COLUMNS = (7, 8)  # [number,] seconds, gyro xyz, accel xyz


class UzhFpvReader:
    """Reads the folder with `left_images.txt`, `right_images.txt`, `imu.txt` and `img`."""

    needs = (
        "left_images.txt, right_images.txt (number, seconds, file), imu.txt, img;"
        " camchain-imucam*.yaml and imu*.yaml there or in a calibration folder"
    )

    def recognise(self, root: Path) -> bool:
        return (root / _LISTS[0]).is_file()

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        if not self.recognise(root):
            raise InputError.at(root, "not a UZH-FPV folder", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        return assemble(
            kind="uzh_fpv",
            name=root.resolve().name,
            root=root,
            listing=_listing(root, findings, limits),
            imu=_imu(root / "imu.txt", limits.imu_max_gap_s, findings),
            calibration=calibration or _calibration(root, limits, findings),
            decode=read_grey,
            findings=findings,
        )


def _listing(root: Path, findings: Findings, limits: ReadingLimits) -> StereoListing:
    stamps: set[int] = set()
    images: list[dict[int, Path]] = []
    for name in _LISTS:
        rows = checked_stamps(read_timed_names(root / name), findings)
        stamps |= rows.keys()
        images.append(camera_images(partial(_named_images, root, name, rows), limits, findings))
    left, right = images
    note_missing_images(stamps, left.keys() | right.keys(), root / _LISTS[0], findings)
    return pair_images(left, right, root, findings, limits)


def _named_images(root: Path, listed: str, rows: dict[int, str]) -> dict[int, Path]:
    found = {t: root / file for t, file in rows.items() if (root / file).is_file()}
    if not found:
        problem = f"none of its {len(rows)} images is there"
        raise NoImagesError.at(root / listed, problem, "names are relative to this folder")
    return found


def _imu(path: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    if not path.exists():
        note_no_imu(path, findings)
        return None
    n_columns = column_count(path, None)
    if n_columns not in _IMU_COLUMNS:
        remedy = "7 or 8 are known: [number], seconds, gyro, accel"
        raise DatasetError.at(path, f"{n_columns} columns", remedy)
    table = read_timed_text(path, n_columns, n_columns - _IMU_COLUMNS[0])
    return checked_imu(table, 0, 3, max_gap_s, findings)


def _calibration(root: Path, limits: ReadingLimits, findings: Findings) -> Calibration:
    places = [root, *_calibration_folders(root), *_calibration_folders(root.resolve().parent)]
    chain = _first(places, _CHAINS)
    if chain is None:
        problem = f"no calibration ({', '.join(_CHAINS)}) here or in a folder *calib*"
        remedy = "copy it here, or give it with --calibration"
        raise CalibrationError.at(root, problem, remedy)
    noise = _first([chain.parent], _NOISES)
    if noise is None:
        note_no_imu_noise(chain.parent / "imu.yaml", findings)
    found = read_kalibr_cameras(chain, limits.need_imu_pose)
    return replace(found, imu_noise=None if noise is None else read_kalibr_noise(noise))


def _calibration_folders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*calib*") if p.is_dir())


def _first(folders: list[Path], patterns: tuple[str, ...]) -> Path | None:
    """The first file that a pattern matches, better patterns first."""
    for pattern in patterns:
        for folder in folders:
            for path in sorted(folder.glob(pattern)):
                return path
    return None
