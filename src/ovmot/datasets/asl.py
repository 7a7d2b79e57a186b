"""What data sets in the ASL layout share: `mav0` with a folder for each sensor."""

from pathlib import Path

from ovmot.cameras.calibration import Calibration
from ovmot.datasets.euroc.calibration import read_euroc
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import (
    StereoListing,
    checked_stamps,
    images_in,
    note_missing_images,
    numbered_images,
    pair_images,
    present_images,
)
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.pose_files import read_stamped_csv, read_stamped_names
from ovmot.errors import InputError
from ovmot.types import ImuData

_IMU_COLUMNS = 7  # ns, gyro xyz, accel xyz


def mav_folder(root: Path) -> Path | None:
    """`mav0` of a sequence's folder, or the folder itself where it is `mav0` or holds `cam0`."""
    for folder in (root / "mav0", root):
        if folder.is_dir() and (folder.name == "mav0" or (folder / "cam0").is_dir()):
            return folder
    return None


def sequence_folder(mav: Path) -> Path:
    """The folder that the sequence is called by: the one around `mav0`."""
    return mav.resolve().parent if mav.resolve().name == "mav0" else mav.resolve()


def asl_listing(mav: Path, findings: Findings) -> StereoListing:
    """The stereo pairs of `cam0` and `cam1`; raises `DatasetError` where there are none."""
    (listed_left, left), (listed_right, right) = (
        _images(mav / camera, findings) for camera in ("cam0", "cam1")
    )
    stamps, found = listed_left | listed_right, left.keys() | right.keys()
    note_missing_images(stamps, found, mav / "cam0" / "data.csv", findings)
    return pair_images(left, right, mav, findings)


def asl_imu(mav: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    """The samples of `imu0/data.csv`, or None, noted, where there is no such file."""
    path = mav / "imu0" / "data.csv"
    if not path.exists():
        note_no_imu(path, findings)
        return None
    return checked_imu(read_stamped_csv(path, _IMU_COLUMNS), 0, 3, max_gap_s, findings)


def sensor_calibration(mav: Path, findings: Findings) -> Calibration:
    """The calibration of the `sensor.yaml` files beside the data."""
    imu = mav / "imu0" / "sensor.yaml"
    if not imu.exists():
        note_no_imu_noise(imu, findings)
    cameras = mav / "cam0" / "sensor.yaml", mav / "cam1" / "sensor.yaml"
    return read_euroc(*cameras, imu if imu.exists() else None)


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


def _images(camera: Path, findings: Findings) -> tuple[set[int], dict[int, Path]]:
    """Stamps of one camera and its images, from `data.csv` or, without it, from file names."""
    listed = camera / "data.csv"
    images_in(camera / "data")  # a missing folder is the clearer error
    if not listed.exists():
        found = numbered_images(camera / "data")
        return set(found), found
    stamps = checked_stamps(read_stamped_names(listed), findings)
    return set(stamps), present_images(stamps, camera / "data", listed)
