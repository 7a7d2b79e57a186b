"""What data sets in the ASL layout share: `mav0` with a folder for each sensor."""

from pathlib import Path

import numpy as np

from ovmot.datasets.calibration import (
    Calibration,
    load_calibration_yaml,
    make_rig,
    read_imu_noise,
    read_pinhole,
)
from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    camera_images,
    checked_stamps,
    images_in,
    note_missing_images,
    numbered_images,
    pair_images,
    present_images,
)
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.text_tables import read_stamped_csv, read_stamped_names
from ovmot.datasets.writing import ImuToWrite, write_rows
from ovmot.geometry import se3
from ovmot.geometry.arrays import IntArray
from ovmot.types import ImuData

_IMU_COLUMNS = 7  # ns, gyro xyz, accel xyz


def mav_folder(root: Path) -> Path | None:
    """`mav0` of a sequence's folder, or the folder itself where it is `mav0` or holds `cam0`."""
    for folder in (root / "mav0", root):
        if folder.is_dir() and (folder.name == "mav0" or (folder / "cam0").is_dir()):
            return folder
    return None


def sequence_folder(mav: Path) -> Path:
    """The folder whose name is the sequence's: the one around `mav0`."""
    return mav.resolve().parent if mav.resolve().name == "mav0" else mav.resolve()


def asl_listing(mav: Path, findings: Findings, limits: ReadingLimits) -> StereoListing:
    """The stereo pairs of `cam0` and `cam1`, by the nearest stamp.

    Raises `DatasetError` where there are none.
    """
    (listed_left, left), (listed_right, right) = (
        _images(mav / camera, limits, findings) for camera in ("cam0", "cam1")
    )
    stamps, found = listed_left | listed_right, left.keys() | right.keys()
    note_missing_images(stamps, found, mav / "cam0" / "data.csv", findings)
    return pair_images(left, right, mav, findings, limits)


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


def _images(
    camera: Path, limits: ReadingLimits, findings: Findings
) -> tuple[set[int], dict[int, Path]]:
    """Stamps of one camera and its images, from `data.csv` or, without it, from file names."""
    listed, folder = camera / "data.csv", camera / "data"
    stamps: dict[int, str] = {}

    def read() -> dict[int, Path]:
        images_in(folder)  # a missing folder is the clearer error
        if not listed.exists():
            return numbered_images(folder)
        stamps.update(checked_stamps(read_stamped_names(listed), findings))
        return present_images(stamps, folder, listed)

    found = camera_images(read, limits, findings)
    return set(stamps) or set(found), found


def read_euroc(cam0: Path, cam1: Path, imu: Path | None) -> Calibration:
    """Rig and IMU noise of the `sensor.yaml` files of two cameras and, if there, of the IMU.

    `T_BS` maps sensor points into the body frame; without an IMU file the body is the IMU.
    Raises `CalibrationError` with file, key and remedy.
    """
    left, right = load_calibration_yaml(cam0), load_calibration_yaml(cam1)
    cameras = tuple(read_pinhole(node, "distortion_coefficients") for node in (left, right))
    T_body_cam0, T_body_cam1 = left.transform("T_BS"), right.transform("T_BS")
    if imu is None:
        return Calibration(
            make_rig(cam1, (cameras[0], cameras[1]), (T_body_cam0, T_body_cam1)), None
        )
    node = load_calibration_yaml(imu)
    T_imu_body = se3.inverse(node.transform("T_BS"))
    poses = T_imu_body @ T_body_cam0, T_imu_body @ T_body_cam1
    return Calibration(make_rig(cam1, (cameras[0], cameras[1]), poses), read_imu_noise(node))


_IMU_HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)


def write_listed(camera: Path, camera_ns: IntArray) -> None:
    """`data.csv` of a camera: stamps and file names."""
    rows = "".join(f"{t},{t}.png\n" for t in camera_ns)
    (camera / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}", encoding="utf-8")


def write_asl_imu(path: Path, imu: ImuToWrite) -> None:
    """`data.csv` of the IMU: ns, gyro, accel."""
    values = np.concatenate([imu.data.gyro, imu.data.accel], axis=1)
    write_rows(path, imu.data.timestamp_ns, values, _IMU_HEADER)
