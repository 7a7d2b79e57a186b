"""Writes a sequence as a KAIST Complex Urban folder, with its truth beside it.

Layout: J. Jeong et al., "Complex Urban Dataset with Multi-level Sensors", IJRR 2019. `truth/` holds
`poses.csv` (ns, IMU position, quaternion w x y z) and the files of `ovmot.datasets.truth`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.writing import (
    SequenceToWrite,
    by_stamp,
    make_folders,
    truth_times,
    writable,
    write_frames,
    write_imu_truth,
    write_rows,
    write_true_poses,
)
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray

_UTM_ORIGIN_M = np.array([332957.38, 4139892.87, 16.9])
_MAGNETIC_FIELD = (0.2, 0.0, -0.4)
_LEFT, _RIGHT = "image/stereo_left", "image/stereo_right"


@dataclass(frozen=True, slots=True)
class _RectifiedPair:
    rotation: tuple[FloatArray, FloatArray]
    projection: tuple[FloatArray, FloatArray]


def write_kaist(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the sequence; yields each frame's time in ns when it is on disk.

    The same sequence gives the same bytes.
    `truth/objects.json` comes last, so an interrupted sequence has none. The format has no place
    for a time offset between camera and IMU: it is in the stamps, and in `truth/imu_errors.yaml`.
    Raises `InputError` where the folder is not empty or not writable, or where the rig's camera
    model is not radial-tangential, the only one that KAIST files hold.
    """
    for camera in sequence.rig.cameras:
        if camera.model.name != "radtan":
            problem = f"KAIST calibration cannot hold the camera model '{camera.model.name}'"
            raise InputError.at(folder, problem, "use radtan, or another format (asl, tum_vi)")
    with writable(folder):
        yield from _write_sequence(folder, sequence)


def _write_sequence(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    make_folders(folder, (_LEFT, _RIGHT, "sensor_data", "calibration"))
    _write_calibration(folder / "calibration", sequence)
    _write_imu(folder, sequence)
    _write_poses(folder, sequence)
    stamps = "".join(f"{t}\n" for t in sequence.camera_ns)
    (folder / "sensor_data/stereo_stamp.csv").write_text(stamps)
    # a grey scene: the raw Bayer mosaic of every colour pattern is the grey image itself
    save = by_stamp(folder / _LEFT, folder / _RIGHT)
    yield from write_frames(folder, sequence, sequence.rig, save)


def _write_imu(folder: Path, sequence: SequenceToWrite) -> None:
    """xsens_imu.csv, whose attitude is the true one, and the truth of the IMU."""
    imu = sequence.imu
    times = imu.data.timestamp_ns
    camera_clock = times - round(1e9 * sequence.rig.time_offset_s)
    quaternion = so3.to_quaternion(sequence.path.pose(camera_clock)[:, :3, :3])
    euler = Rotation.from_quat(quaternion).as_euler("xyz")
    field = np.tile(_MAGNETIC_FIELD, (len(times), 1))
    write_rows(
        folder / "sensor_data/xsens_imu.csv", times,
        np.concatenate([quaternion, euler, imu.data.gyro, imu.data.accel, field], axis=1),
    )  # fmt: skip
    write_imu_truth(folder, imu)


def _write_poses(folder: Path, sequence: SequenceToWrite) -> None:
    """truth/poses.csv of the IMU, and global_pose.csv of the vehicle."""
    write_true_poses(folder, sequence)
    times = truth_times(sequence)
    T_utm_vehicle = sequence.path.pose(times) @ np.linalg.inv(sequence.T_vehicle_imu)
    T_utm_vehicle[:, :3, 3] += _UTM_ORIGIN_M
    write_rows(folder / "global_pose.csv", times, T_utm_vehicle[:, :3].reshape(-1, 12))


def _write_calibration(folder: Path, sequence: SequenceToWrite) -> None:
    rig = sequence.rig
    pair = _rectify(sequence.rig)
    for side, name, camera in zip((0, 1), ("left", "right"), rig.cameras, strict=True):
        _write_camera(
            folder / f"{name}.yaml", name, camera, pair.rotation[side], pair.projection[side]
        )
    T_vehicle_cam0 = sequence.T_vehicle_imu @ rig.T_imu_cam0
    _write_mount(folder / "Vehicle2Stereo.txt", "Vehicle2Stereo", T_vehicle_cam0)
    _write_mount(folder / "Vehicle2IMU.txt", "Vehicle2IMU", sequence.T_vehicle_imu)


def _rectify(rig: StereoRig) -> _RectifiedPair:
    """OpenCV's rectification, from which readers get the right camera's pose."""
    left, right = rig.cameras
    T_cam1_cam0 = rig.T_cam1_cam0
    R0, R1, P0, P1, *_ = cv2.stereoRectify(
        left.matrix, left.distortion, right.matrix, right.distortion,
        (left.width, left.height), T_cam1_cam0[:3, :3].copy(), T_cam1_cam0[:3, 3].copy(),
        flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )  # fmt: skip
    return _RectifiedPair(
        (np.asarray(R0, dtype=np.float64), np.asarray(R1, dtype=np.float64)),
        (np.asarray(P0, dtype=np.float64), np.asarray(P1, dtype=np.float64)),
    )


def _write_camera(
    path: Path, name: str, camera: Camera, rotation: FloatArray, projection: FloatArray
) -> None:
    """One camera in OpenCV's file storage, distortion padded to five terms."""
    distortion = np.zeros((1, 5))
    distortion[0, : len(camera.distortion)] = camera.distortion
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if not storage.isOpened():
        raise InputError.at(path, "cannot be written", "is the disk full?")
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("camera_name", name)
    storage.write("camera_matrix", camera.matrix)
    storage.write("distortion_model", "plumb_bob")
    storage.write("distortion_coefficients", distortion)
    storage.write("rectification_matrix", rotation)
    storage.write("projection_matrix", projection)
    storage.release()


def _write_mount(path: Path, title: str, T_vehicle_sensor: FloatArray) -> None:
    """A sensor's pose on the vehicle: p_vehicle = R p_sensor + T."""
    R, p = T_vehicle_sensor[:3, :3], T_vehicle_sensor[:3, 3]
    rpy = Rotation.from_matrix(R).as_euler("xyz", degrees=True)

    def line(values: FloatArray) -> str:
        return " ".join(f"{x:.12g}" for x in values.ravel())

    path.write_text(
        f"{title} calibration\nRPY(degree) R(row major) T(meter)\n"
        f"RPY: {line(rpy)}\nR: {line(R)}\nT: {line(p)}\n"
    )
