"""EuRoC/ASL folders: `mav0/cam0`, `mav0/cam1`, `mav0/imu0`."""

from pathlib import Path

from ovmot.cameras.calibration import Calibration
from ovmot.cameras.euroc import read_euroc
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
from ovmot.datasets.images import read_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.errors import InputError
from ovmot.formats import read_stamped_csv, read_stamped_names
from ovmot.types import ImuData

_IMU_COLUMNS = 7  # ns, gyro xyz, accel xyz


class EurocReader:
    """Reads the folder that holds `mav0`, or `mav0` itself."""

    needs = "mav0/cam0, mav0/cam1 (sensor.yaml, data/*.png, data.csv), mav0/imu0"

    def recognise(self, root: Path) -> bool:
        return _mav(root) is not None

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        imu_max_gap_s: float,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        mav = _mav(root)
        if mav is None:
            raise InputError.at(root, "not a EuRoC folder", f"it needs {self.needs}")
        if sequence is not None:
            raise InputError.at(root, "holds one sequence", f"leave out '--sequence {sequence}'")
        findings = Findings()
        listing = _listing(mav, findings)
        imu = _imu(mav / "imu0" / "data.csv", imu_max_gap_s, findings)
        found = calibration or _calibration(mav, findings)
        name = mav.resolve().parent.name if mav.resolve().name == "mav0" else mav.resolve().name
        return assemble(
            kind="euroc",
            name=name,
            root=root,
            calibration=found,
            listing=listing,
            imu=imu,
            decode=read_grey,
            findings=findings,
        )


def _mav(root: Path) -> Path | None:
    for folder in (root / "mav0", root):
        if folder.is_dir() and (folder.name == "mav0" or (folder / "cam0").is_dir()):
            return folder
    return None


def _listing(mav: Path, findings: Findings) -> StereoListing:
    (listed_left, left), (listed_right, right) = (
        _images(mav / camera, findings) for camera in ("cam0", "cam1")
    )
    stamps, found = listed_left | listed_right, left.keys() | right.keys()
    note_missing_images(stamps, found, mav / "cam0" / "data.csv", findings)
    return pair_images(left, right, mav, findings)


def _images(camera: Path, findings: Findings) -> tuple[set[int], dict[int, Path]]:
    """Stamps of one camera and its images, from `data.csv` or, without it, from file names."""
    listed = camera / "data.csv"
    images_in(camera / "data")  # a missing folder is the clearer error
    if not listed.exists():
        found = numbered_images(camera / "data")
        return set(found), found
    stamps = checked_stamps(read_stamped_names(listed), findings)
    return set(stamps), present_images(stamps, camera / "data", listed)


def _imu(path: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    if not path.exists():
        findings.note("no_imu", 1, f"{path}: no IMU file; the ego motion must come from poses")
        return None
    return checked_imu(read_stamped_csv(path, _IMU_COLUMNS), 0, 3, max_gap_s, findings)


def _calibration(mav: Path, findings: Findings) -> Calibration:
    imu = mav / "imu0" / "sensor.yaml"
    if not imu.exists():
        findings.note("no_imu_noise", 1, f"{imu}: missing; the IMU noise of the settings is used")
    cameras = mav / "cam0" / "sensor.yaml", mav / "cam1" / "sensor.yaml"
    return read_euroc(*cameras, imu if imu.exists() else None)
