"""Writes a sequence as a EuRoC/ASL folder (`mav0`), with its truth beside it.

Layout: M. Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016. `mav0` holds the true
states in `state_groundtruth_estimate0`, `truth/` beside it the files of `ovmot.datasets.truth`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ovmot.cameras.camera import Camera
from ovmot.datasets.asl import write_asl_imu, write_listed
from ovmot.datasets.calibration import NOISE_KEYS
from ovmot.datasets.writing import (
    ImuToWrite,
    SequenceToWrite,
    by_stamp,
    make_folders,
    truth_times,
    writable,
    write_frames,
    write_imu_truth,
    write_rows,
)
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray

MODEL_NAMES = {"radtan": "radial-tangential", "equidistant": "equidistant", "none": "none"}
"""Our names of the camera models, and those of `sensor.yaml`."""

_LEFT, _RIGHT, _IMU = "mav0/cam0", "mav0/cam1", "mav0/imu0"
_STATES = "mav0/state_groundtruth_estimate0"
_STATES_HEADER = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
    "b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],"
    "b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
)


def write_asl(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the sequence; yields each frame's time in ns when it is on disk.

    The same sequence gives the same bytes.
    `truth/objects.json` comes last, so an interrupted sequence has none. The format has no place
    for a time offset between camera and IMU: it is in the stamps, and in `truth/imu_errors.yaml`.
    Raises `InputError` where the folder is not empty or not writable, or where a camera has what
    `sensor.yaml` cannot hold: an unknown camera model, or skew.
    """
    for camera in sequence.rig.cameras:
        _check_camera(folder, camera)
    with writable(folder):
        yield from _write_sequence(folder, sequence)


def _check_camera(folder: Path, camera: Camera) -> None:
    name = camera.model.name
    if name not in MODEL_NAMES:
        problem = f"EuRoC calibration cannot hold the camera model '{name}'"
        raise InputError.at(folder, problem, f"use {', '.join(MODEL_NAMES)}")
    if camera.intrinsics[4] != 0.0:
        problem = f"EuRoC calibration cannot hold a skew of {camera.intrinsics[4]:g}"
        raise InputError.at(folder, problem, "use cameras without skew")


def _write_sequence(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    rig = sequence.rig
    left, right = folder / _LEFT / "data", folder / _RIGHT / "data"
    make_folders(folder, (f"{_LEFT}/data", f"{_RIGHT}/data", _IMU, _STATES))
    frame_hz = _rate(sequence.camera_ns)
    for name, camera, T_imu_cam in (
        (_LEFT, rig.cam0, rig.T_imu_cam0),
        (_RIGHT, rig.cam1, rig.T_imu_cam1),
    ):
        _write_camera(folder / name, camera, T_imu_cam, frame_hz, sequence.camera_ns)
    imu = sequence.imu
    _write_imu(folder / _IMU, imu)
    _write_states(folder / _STATES, sequence)
    write_imu_truth(folder, imu)
    yield from write_frames(folder, sequence, rig, by_stamp(left, right))


def _write_camera(
    folder: Path, camera: Camera, T_imu_cam: FloatArray, frame_hz: float, camera_ns: IntArray
) -> None:
    write_listed(folder, camera_ns)
    values = {
        "sensor_type": "camera",
        "comment": "simulated",
        "T_BS": _matrix(T_imu_cam),
        "rate_hz": frame_hz,
        "resolution": [camera.width, camera.height],
        "camera_model": "pinhole",
        "intrinsics": camera.intrinsics[:4].tolist(),
        "distortion_model": MODEL_NAMES[camera.model.name],
        "distortion_coefficients": camera.distortion.tolist(),
    }
    _write_yaml(folder / "sensor.yaml", values)


def _write_imu(folder: Path, imu: ImuToWrite) -> None:
    """data.csv, and sensor.yaml where the IMU has noise: readers refuse densities of zero."""
    write_asl_imu(folder / "data.csv", imu)
    noise = {key: getattr(imu.noise, name) for name, key in NOISE_KEYS.items()}
    if min(noise.values()) > 0.0:
        sensor = {"sensor_type": "imu", "comment": "simulated", "T_BS": _matrix(np.eye(4))}
        _write_yaml(folder / "sensor.yaml", {**sensor, "rate_hz": imu.rate_hz, **noise})


def _write_states(folder: Path, sequence: SequenceToWrite) -> None:
    """True pose, velocity in the world and biases; between IMU samples these are interpolated."""
    times, imu = truth_times(sequence), sequence.imu
    T_world_imu = sequence.path.pose(times)
    wxyz = so3.to_quaternion(T_world_imu[:, :3, :3])[:, [3, 0, 1, 2]]
    biases = np.concatenate([imu.gyro_bias, imu.accel_bias], axis=1)
    start_ns = int(times[0])
    at = times - start_ns + round(1e9 * sequence.rig.time_offset_s)
    known = imu.data.timestamp_ns - start_ns
    bias = np.stack([np.interp(at, known, column) for column in biases.T], axis=-1)
    states = np.concatenate(
        [T_world_imu[:, :3, 3], wxyz, sequence.path.velocity(times), bias], axis=1
    )
    write_rows(folder / "data.csv", times, states, _STATES_HEADER)
    values = {"sensor_type": "visual-inertial", "comment": "simulated", "T_BS": _matrix(np.eye(4))}
    _write_yaml(folder / "sensor.yaml", values)


def _rate(timestamp_ns: IntArray) -> float:
    """Samples a second; 0 for a single one."""
    return float(1e9 / np.median(np.diff(timestamp_ns))) if len(timestamp_ns) > 1 else 0.0


def _matrix(T: FloatArray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel().tolist()}


def _write_yaml(path: Path, values: dict[str, Any]) -> None:
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")
