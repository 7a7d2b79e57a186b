"""Writes a sequence as a KITTI raw drive, `sync` or `extract`, with its truth beside it.

Layout: A. Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013. The two differ as
the data set's do: `extract` has the rig's own images and all IMU samples; `sync` rectified
images, and of the samples the nearest one to each of them.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig, rectified
from ovmot.datasets.writing import (
    FrameToWrite,
    SequenceToWrite,
    make_folders,
    writable,
    write_frames,
    write_imu_truth,
    write_png,
    write_true_poses,
)
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray

_DATE = "2011_09_26"
_VELO_IMU = np.array([-0.81, 0.32, -0.8])
_FIELDS, _ACCEL, _GYRO = 30, slice(11, 14), slice(17, 20)


def write_kitti_sync(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write a `_sync` drive into the folder of its date, as `write_asl`.

    Raises `InputError` for another camera model than `radtan`, and where the folder is not empty or
    not writable. The format has no place for a time offset.
    """
    return _checked(folder, sequence, "sync")


def write_kitti_extract(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """The same as an `_extract` drive."""
    return _checked(folder, sequence, "extract")


def _checked(folder: Path, sequence: SequenceToWrite, form: str) -> Iterator[int]:
    for camera in sequence.rig.cameras:
        if camera.model.name != "radtan":
            problem = f"KITTI calibration cannot hold the camera model '{camera.model.name}'"
            raise InputError.at(folder, problem, "use radtan, or another format (asl, tum_vi)")
    with writable(folder):
        yield from _write(folder, sequence, form)


def _write(folder: Path, sequence: SequenceToWrite, form: str) -> Iterator[int]:
    rig = sequence.rig
    seen = rectified(rig) if form == "sync" else rig
    drive = folder / _DATE / f"{_DATE}_drive_0001_{form}"
    place = drive.relative_to(folder)
    make_folders(folder, (f"{place}/image_00/data", f"{place}/image_01/data", f"{place}/oxts/data"))
    _write_calibration(folder / _DATE, rig)
    frame_ns = sequence.camera_ns
    imu = sequence.imu
    samples = np.arange(len(imu.data))
    if form == "sync":
        at = frame_ns + round(1e9 * rig.time_offset_s)
        samples = np.abs(imu.data.timestamp_ns[:, None] - at).argmin(axis=0)
    _write_times(drive / "oxts", imu.data.timestamp_ns[samples])
    for n, i in enumerate(samples):
        packet = np.zeros(_FIELDS)
        packet[_ACCEL], packet[_GYRO] = imu.data.accel[i], imu.data.gyro[i]
        (drive / f"oxts/data/{n:010d}.txt").write_text(" ".join(f"{x:.12f}" for x in packet) + "\n")
    write_imu_truth(folder, imu)
    write_true_poses(folder, sequence)
    for camera in ("image_00", "image_01"):
        _write_times(drive / camera, frame_ns)
    number = {int(t): n for n, t in enumerate(frame_ns)}

    def save(frame: FrameToWrite) -> None:
        name = f"{number[frame.frame.timestamp_ns]:010d}.png"
        write_png(drive / "image_00/data" / name, frame.frame.left)
        write_png(drive / "image_01/data" / name, frame.frame.pair[1])

    yield from write_frames(folder, sequence, seen, save)


def _write_times(folder: Path, timestamp_ns: IntArray) -> None:
    lines = []
    for time_ns in timestamp_ns.tolist():
        seconds, rest = divmod(time_ns, 10**9)
        lines.append(f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest:09d}\n")
    (folder / "timestamps.txt").write_text("".join(lines))


def _write_calibration(folder: Path, rig: StereoRig) -> None:
    """The three files of a date; the colour cameras 02 and 03 are said to be the grey ones."""
    level = rectified(rig)
    R_rect_imu = level.T_imu_cam0[:3, :3].T
    keys: dict[str, FloatArray] = {}
    for i in range(4):
        camera, T_imu_cam = (rig.cam0, rig.T_imu_cam0) if i % 2 == 0 else (rig.cam1, rig.T_imu_cam1)
        T_cam_cam0 = se3.inverse(T_imu_cam) @ rig.T_imu_cam0
        distortion = np.zeros(5)
        distortion[: len(camera.distortion)] = camera.distortion
        size = np.array([camera.width, camera.height])
        K_rect, baseline = level.cam0.matrix, np.zeros(3)
        if i % 2:
            baseline = level.T_cam1_cam0[:3, 3]
        keys |= {
            f"S_{i:02d}": size, f"K_{i:02d}": camera.matrix, f"D_{i:02d}": distortion,
            f"R_{i:02d}": T_cam_cam0[:3, :3], f"T_{i:02d}": T_cam_cam0[:3, 3],
            f"S_rect_{i:02d}": size, f"R_rect_{i:02d}": R_rect_imu @ T_imu_cam[:3, :3],
            f"P_rect_{i:02d}": K_rect @ np.column_stack([np.eye(3), baseline]),
        }  # fmt: skip
    _write_keys(folder / "calib_cam_to_cam.txt", keys)
    T_velo_imu = se3.make(np.eye(3), _VELO_IMU)
    T_cam0_velo = se3.inverse(rig.T_imu_cam0) @ se3.inverse(T_velo_imu)
    for name, T in (("velo_to_cam", T_cam0_velo), ("imu_to_velo", T_velo_imu)):
        _write_keys(folder / f"calib_{name}.txt", {"R": T[:3, :3], "T": T[:3, 3]})


def _write_keys(path: Path, values: dict[str, FloatArray]) -> None:
    lines = (f"{k}: {' '.join(f'{x:.16e}' for x in v.ravel())}\n" for k, v in values.items())
    path.write_text("calib_time: 01-Jan-2000 00:00:00\n" + "".join(lines))
