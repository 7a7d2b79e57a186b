"""KAIST Complex Urban folders: raw Bayer stereo images and an Xsens IMU."""

from dataclasses import replace
from pathlib import Path

from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, note_no_imu, refuse_choice
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    pair_listed,
)
from ovmot.datasets.images import read_bayer_as_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.kaist.calibration import read_kaist_calibration
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import (
    StampedNames,
    column_count,
    read_stamped_csv,
    read_stamped_names,
)
from ovmot.errors import DatasetError, InputError
from ovmot.types import ImuData

# ns, quaternion xyzw, euler xyz, gyro xyz, accel xyz, magnetometer xyz
_IMU_COLUMNS = 17
_IMU_COLUMNS_WITHOUT_GYRO = 8
_GYRO, _ACCEL = 7, 10  # of the values, the stamp left out


class KaistReader:
    """Reads a folder with `image`, `sensor_data` and `calibration`."""

    needs = (
        "image/stereo_left, image/stereo_right, sensor_data/xsens_imu.csv,"
        " calibration/left.yaml, right.yaml, Vehicle2Stereo.txt"
    )

    def recognise(self, root: Path) -> bool:
        return any((root / "image" / f"stereo_{side}").is_dir() for side in ("left", "right"))

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        if not self.recognise(root):
            raise InputError.at(root, "not a KAIST folder", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        listing = _listing(root, findings, limits)
        imu = _imu(root / "sensor_data" / "xsens_imu.csv", limits.imu_max_gap_s, findings)
        found = calibration or read_kaist_calibration(root / "calibration")
        name = root.resolve().name
        return assemble(
            kind="kaist",
            name=name,
            root=root,
            calibration=found,
            listing=listing,
            imu=imu,
            decode=read_bayer_as_grey,
            findings=findings,
        )


def _listing(root: Path, findings: Findings, limits: ReadingLimits) -> StereoListing:
    folders = root / "image" / "stereo_left", root / "image" / "stereo_right"
    listed = root / "sensor_data" / "stereo_stamp.csv"
    return pair_listed(folders, listed, _bare_stamps, root, findings, limits)


def _bare_stamps(listed: Path) -> StampedNames:
    """The listed stamps; what stands behind them is no name of a file."""
    found = read_stamped_names(listed)
    return replace(found, names=("",) * len(found.names))


def _imu(path: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    if not path.exists():
        note_no_imu(path, findings)
        return None
    if column_count(path, ",") == _IMU_COLUMNS_WITHOUT_GYRO:
        problem = "8 columns: this early KAIST sequence has orientation only, no gyro and no accel"
        raise DatasetError.at(path, problem, "use a sequence whose IMU file has 17 columns")
    table = read_stamped_csv(path, _IMU_COLUMNS)
    return checked_imu(table, _GYRO, _ACCEL, max_gap_s, findings)
