"""What data sets in the ASL layout share: `mav0` with a folder for each sensor."""

from pathlib import Path

import numpy as np

from ovmot.datasets.calibration import (
    Calibration,
    calibrated_camera,
    load_calibration_yaml,
    make_rig,
    read_imu_noise,
)
from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    camera_images,
    checked_stamps,
    images_in,
    listed_images,
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


def asl_listing(
    mav: Path,
    findings: Findings,
    limits: ReadingLimits,
    cameras: tuple[str, ...] = ("cam0", "cam1"),
) -> StereoListing:
    """The stereo pairs of two folders, by the nearest stamp, or the images of one.

    Raises `DatasetError` where there are none.
    """
    if len(cameras) == 1:
        (folder,) = cameras
        stamps, images = _images(mav / folder, limits, findings)
        note_missing_images(stamps, images.keys(), mav / folder / "data.csv", findings)
        return listed_images(images)
    (listed_left, left), (listed_right, right) = (
        _images(mav / camera, limits, findings) for camera in cameras
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
    right = mav / "cam1"
    if not right.exists():
        text = f"{mav}: holds no cam1: run with one camera"
        findings.note("one_camera", 1, text)
    return read_euroc(
        mav / "cam0" / "sensor.yaml",
        right / "sensor.yaml" if right.exists() else None,
        imu if imu.exists() else None,
    )


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


def read_euroc(cam0: Path, cam1: Path | None, imu: Path | None) -> Calibration:
    """Rig and IMU noise of the `sensor.yaml` files of two cameras, or of one, and, if there, of the
    IMU.

    `T_BS` maps sensor points into the body frame; without an IMU file the body is the IMU.
    Raises `CalibrationError` with file, key and remedy.
    """
    files = (cam0,) if cam1 is None else (cam0, cam1)
    nodes = [load_calibration_yaml(file) for file in files]
    cameras = [calibrated_camera(node, "distortion_coefficients") for node in nodes]
    poses, noise = [node.transform("T_BS") for node in nodes], None
    if imu is not None:
        node = load_calibration_yaml(imu)
        T_imu_body = se3.inverse(node.transform("T_BS"))
        poses, noise = [T_imu_body @ T for T in poses], read_imu_noise(node)
    names = ("cam0",) if cam1 is None else ("cam0", "cam1")
    return Calibration(make_rig(files[-1], cameras, poses), noise, names)


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
