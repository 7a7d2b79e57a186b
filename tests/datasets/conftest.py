"""Tiny data sets of every kind, written into `tmp_path`."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from sim_fixtures import assert_same_rig, small_simulation
from variant_fixtures import four_seasons, tum_vi, uzh_fpv, viode

__all__ = [
    "assert_same_rig",
    "four_seasons",
    "small_simulation",
    "tum_vi",
    "uzh_fpv",
    "viode",
]

WIDTH, HEIGHT = 32, 24
FRAME_NS = tuple(1_403_636_580_000_000_555 + 100_000_000 * i for i in range(6))

_CAMERA = """\
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, 0.1, -1.0, 0.0, 0.0, {y}, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
resolution: [32, 24]
camera_model: pinhole
intrinsics: [20.0, 21.0, 16.0, 12.0] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.01, 1.0e-3, 2e-4]
"""
_IMU = """\
T_BS: {cols: 4, rows: 4, data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}
gyroscope_noise_density: 1.6968e-04
gyroscope_random_walk: 1.9393e-05
accelerometer_noise_density: 2e-3
accelerometer_random_walk: 3.0e-3
"""
_KAIST_CAMERA = """\
%YAML:1.0
---
image_width: 32
image_height: 24
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 20., 0.5, 16., 0., 21., 12., 0., 0., 1. ]
distortion_model: plumb_bob
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.05, 0.1, 0., 0., -0.08 ]
rectification_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
projection_matrix: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [ 20., 0., 16., SHIFT, 0., 20., 12., 0., 0., 0., 1., 0. ]
"""


def image_of(number: int, channels: int = 1) -> np.ndarray:
    """An image that tells its number: `number` * 10 everywhere."""
    shape = (HEIGHT, WIDTH) if channels == 1 else (HEIGHT, WIDTH, channels)
    return np.full(shape, 10 * number, dtype=np.uint8)


def write_images(folder: Path, names: list[str], channels: int = 1, first: int = 0) -> None:
    folder.mkdir(parents=True)
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / name), image_of(first + i, channels))


def imu_lines(n_columns: int, period_ns: int = 5_000_000) -> list[str]:
    """Samples from 50 ms before the first frame to 50 ms after the last, gyro 0.1 0.2 0.3."""
    gyro_accel = ["0.1", "0.2", "0.3", "0.0", "0.5", "9.8"]
    values = (
        gyro_accel if n_columns == 7 else ["0"] * 3 + ["1"] + ["0"] * 3 + gyro_accel + ["7"] * 3
    )
    stamps = range(FRAME_NS[0] - 50_000_000, FRAME_NS[-1] + 50_000_001, period_ns)
    return [",".join([str(stamp), *values]) for stamp in stamps]


@pytest.fixture
def euroc(tmp_path: Path) -> Path:
    """A EuRoC folder of six pairs and 121 IMU samples."""
    root = tmp_path / "MH_tiny"
    for camera, y in (("cam0", 0.05), ("cam1", -0.06)):
        folder = root / "mav0" / camera
        names = [f"{stamp}.png" for stamp in FRAME_NS]
        write_images(folder / "data", names, first=0 if camera == "cam0" else 10)
        rows = [f"{stamp},{stamp}.png" for stamp in FRAME_NS]
        (folder / "data.csv").write_text("\r\n".join(["#timestamp [ns],filename", *rows]) + "\r\n")
        (folder / "sensor.yaml").write_text(_CAMERA.format(y=y))
    imu = root / "mav0" / "imu0"
    imu.mkdir()
    (imu / "data.csv").write_text("\n".join(["#timestamp [ns],w_x,w_y", *imu_lines(7)]) + "\n")
    (imu / "sensor.yaml").write_text(_IMU)
    return root


@pytest.fixture
def kaist(tmp_path: Path) -> Path:
    """A KAIST folder of six raw pairs; the list of stamps names one more."""
    root = tmp_path / "urban_tiny"
    names = [f"{stamp}.png" for stamp in FRAME_NS]
    for side in ("left", "right"):
        write_images(root / "image" / f"stereo_{side}", names)
    sensors, calibration = root / "sensor_data", root / "calibration"
    sensors.mkdir()
    calibration.mkdir()
    stamps = [*FRAME_NS, FRAME_NS[-1] + 100_000_000]
    (sensors / "stereo_stamp.csv").write_text("".join(f"{stamp}\n" for stamp in stamps))
    (sensors / "xsens_imu.csv").write_text("\n".join(imu_lines(17, 10_000_000)) + "\n")
    (calibration / "left.yaml").write_text(_KAIST_CAMERA.replace("SHIFT", "0."))
    (calibration / "right.yaml").write_text(_KAIST_CAMERA.replace("SHIFT", "-9.6"))
    (calibration / "Vehicle2Stereo.txt").write_text(
        "Stereo camera\nRPY: -90 0 -90\nR: 0 0 1 -1 0 0 0 -1 0\nT: 1.64 0.24 1.58\n"
    )
    return root


@pytest.fixture
def kitti_tracking(tmp_path: Path) -> Path:
    """KITTI tracking's `training` with sequence 0010 of four colour pairs, and its calibration."""
    root = tmp_path / "training"
    for folder in ("image_02", "image_03"):
        write_images(root / folder / "0010", [f"{i:06d}.png" for i in range(4)], channels=3)
    (root / "calib").mkdir()
    (root / "calib" / "0010.txt").write_text(
        "P0: 20 0 16 0 0 20 12 0 0 0 1 0\nP1: 20 0 16 -10 0 20 12 0 0 0 1 0\n"
        "P2: 20 0 16 1.2 0 20 12 0 0 0 1 0\nP3: 20 0 16 -9.4 0 20 12 0 0 0 1 0\n"
        "R_rect 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_cam 0 -1 0 0.0 0 0 -1 -0.1 1 0 0 -0.3\n"
        "Tr_imu_velo 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.8\n\n"
    )
    return root


@pytest.fixture
def kitti_odometry(tmp_path: Path) -> Path:
    """KITTI odometry with sequence 00 of three grey pairs."""
    root = tmp_path / "dataset"
    folder = root / "sequences" / "00"
    for name in ("image_0", "image_1"):
        write_images(folder / name, [f"{i:06d}.png" for i in range(3)])
    (folder / "times.txt").write_text("0.000000e+00\n1.038590e-01\n2.076000e-01\n")
    (folder / "calib.txt").write_text(
        "P0: 20 0 16 0 0 20 12 0 0 0 1 0\nP1: 20 0 16 -10 0 20 12 0 0 0 1 0\n"
    )
    return root


@pytest.fixture
def edit() -> Callable[[Path, str, str], None]:
    """Replaces text in a file that must be there."""

    def replace(path: Path, old: str, new: str) -> None:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return replace


_RAW_CAMERA = """\
S_{i}: 32 24
K_{i}: 20 0 16 0 21 12 0 0 1
D_{i}: -0.3 0.1 0.001 -0.002 0.01
R_{i}: 1 0 0 0 1 0 0 0 1
T_{i}: {t} 0 0
S_rect_{i}: 32 24
R_rect_{i}: 1 0 0 0 1 0 0 0 1
P_rect_{i}: 18 0 16 {p} 0 18 12 0 0 0 1 0
"""


@pytest.fixture
def kitti_raw(tmp_path: Path) -> Path:
    """A date of KITTI raw with drive 0001 in both forms: four pairs, times 0.1 s apart."""
    root = tmp_path / "2011_09_26"
    for form, rate in (("sync", 10), ("extract", 100)):
        drive = root / f"2011_09_26_drive_0001_{form}"
        for camera in ("image_00", "image_01"):
            write_images(drive / camera / "data", [f"{i:010d}.png" for i in range(4)])
            times = (f"2011-09-26 13:02:{25 + 0.1 * i:.9f}\n" for i in range(4))
            (drive / camera / "timestamps.txt").write_text("".join(times))
        (drive / "oxts" / "data").mkdir(parents=True)
        count = 1 + 3 * rate // 10
        times = (f"2011-09-26 13:02:{25 + i / rate:.9f}\n" for i in range(count))
        (drive / "oxts" / "timestamps.txt").write_text("".join(times))
        for i in range(count):
            packet = [float(k) for k in range(30)]
            packet[11:14], packet[17:20] = [0.1, 0.2, 9.8], [0.01, 0.02, 0.001 * i]
            text = " ".join(map(str, packet))
            (drive / "oxts" / "data" / f"{i:010d}.txt").write_text(text)
    (root / "calib_cam_to_cam.txt").write_text(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\n"
        + _RAW_CAMERA.format(i="00", t=0, p=0)
        + _RAW_CAMERA.format(i="01", t=-0.5, p=-9)
    )
    (root / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.1 -0.3\n")
    (root / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n")
    return root
