"""Writes a simulation as a KAIST Complex Urban folder, with its truth beside it.

Layout: J. Jeong et al., "Complex Urban Dataset with Multi-level Sensors", IJRR 2019. `truth/` holds
`poses.csv` (ns, IMU position, quaternion w x y z), `objects.json`, and `<ns>.png`, the object id at
every left pixel.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ovmot.cameras.camera import Camera
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.sim.render import RenderedFrame, render_stereo
from ovmot.sim.simulation import Simulation

_UTM_ORIGIN_M = np.array([332957.38, 4139892.87, 16.9])
_MAGNETIC_FIELD = (0.2, 0.0, -0.4)
_IMU_LEAD_S, _IMU_TAIL_S = 0.5, 0.3
_PNG_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_FOLDERS = ("image/stereo_left", "image/stereo_right", "sensor_data", "calibration", "truth")


@dataclass(frozen=True, slots=True)
class _RectifiedPair:
    rotation: tuple[FloatArray, FloatArray]
    projection: tuple[FloatArray, FloatArray]


def write_kaist(folder: Path, simulation: Simulation, seed: int) -> Iterator[int]:
    """Render and write the sequence; yields each frame's time in ns when it is on disk.

    `seed` starts the noise of images and IMU: the same simulation and seed give the same bytes.
    Raises `InputError` where the folder is not empty or not writable, or where the rig's lenses
    are not the radial-tangential ones that KAIST files hold.
    """
    _check(folder, simulation)
    try:
        yield from _write_sequence(folder, simulation, seed)
    except OSError as error:
        raise InputError.at(folder, f"cannot be written: {error.strerror}") from error


def _write_sequence(folder: Path, simulation: Simulation, seed: int) -> Iterator[int]:
    image_seed, imu_seed = np.random.SeedSequence(seed).spawn(2)
    for name in _FOLDERS:
        (folder / name).mkdir(parents=True, exist_ok=True)
    _write_calibration(folder / "calibration", simulation)
    _write_imu_and_poses(folder, simulation, np.random.default_rng(imu_seed))
    stamps = "".join(f"{t}\n" for t in simulation.camera_ns)
    (folder / "sensor_data/stereo_stamp.csv").write_text(stamps)
    frames = render_stereo(
        simulation.scene, simulation.rig, simulation.path, simulation.camera_ns,
        simulation.optics.noise_grey, np.random.default_rng(image_seed),
    )  # fmt: skip
    yield from _write_frames(folder, simulation, frames)


def _check(folder: Path, simulation: Simulation) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError.at(folder, "exists and is not an empty folder", "choose another")
    for camera in simulation.rig.cameras:
        if camera.lens.name != "radtan":
            raise InputError.at(
                folder, f"KAIST calibration cannot hold a lens '{camera.lens.name}'", "use radtan"
            )


def _write_frames(
    folder: Path, simulation: Simulation, frames: Iterable[RenderedFrame]
) -> Iterator[int]:
    truth: list[dict[str, Any]] = []
    for frame in frames:
        time_ns = frame.frame.timestamp_ns
        # a grey scene: the raw Bayer mosaic of every colour pattern is the grey picture itself
        _write_png(folder / f"image/stereo_left/{time_ns}.png", frame.frame.left)
        _write_png(folder / f"image/stereo_right/{time_ns}.png", frame.frame.right)
        _write_png(folder / f"truth/{time_ns}.png", frame.left.object_id)
        truth.append(_truth_of_frame(simulation, time_ns, frame.left.object_id))
        yield time_ns
    (folder / "truth/objects.json").write_text(json.dumps(truth))


def _write_png(path: Path, image: Image) -> None:
    if not cv2.imwrite(str(path), image, _PNG_FAST):
        raise InputError.at(path, "cannot be written", "is the disk full?")


def _truth_of_frame(simulation: Simulation, time_ns: int, object_id: Image) -> dict[str, Any]:
    """One entry of objects.json: box centres, metres, rad, m/s, in the world frame."""
    visible = np.bincount(object_id.ravel(), minlength=256)
    objects = []
    for mover in simulation.scene.movers:
        state = mover.state(time_ns)
        x, y, z = (float(c) for c in state.center)
        length, width, height = (float(c) for c in state.size)
        objects.append(
            {
                "id": state.object_id, "cls": state.category,
                "x": x, "y": y, "z": z, "yaw": state.yaw,
                "l": length, "w": width, "h": height,
                "vx": float(state.velocity[0]), "vy": float(state.velocity[1]),
                "yaw_rate": state.yaw_rate, "visible_px": int(visible[state.object_id]),
            }
        )  # fmt: skip
    T_w_body = simulation.path.pose(time_ns).tolist()
    return {"t_ns": time_ns, "T_w_body": T_w_body, "objects": objects}


def _write_imu_and_poses(folder: Path, simulation: Simulation, rng: np.random.Generator) -> None:
    """xsens_imu.csv, truth/poses.csv at the IMU's rate, and global_pose.csv of the vehicle."""
    times = imu_times(simulation)
    perfect = perfect_imu(simulation.path, times, time_offset_s=simulation.rig.time_offset_s)
    imu = noisy_imu(
        perfect, simulation.imu.noise, rng,
        gyro_bias=simulation.imu.gyro_bias, accel_bias=simulation.imu.accel_bias,
    ).data  # fmt: skip
    T_world_imu = simulation.path.pose(times)
    quaternion = so3.to_quaternion(T_world_imu[:, :3, :3])
    euler = Rotation.from_quat(quaternion).as_euler("xyz")
    field = np.tile(_MAGNETIC_FIELD, (len(times), 1))
    _write_rows(
        folder / "sensor_data/xsens_imu.csv", times,
        np.concatenate([quaternion, euler, imu.gyro, imu.accel, field], axis=1),
    )  # fmt: skip
    wxyz = quaternion[:, [3, 0, 1, 2]]
    within = (times >= simulation.camera_ns[0]) & (times <= simulation.camera_ns[-1])
    poses = np.concatenate([T_world_imu[:, :3, 3], wxyz], axis=1)
    _write_rows(folder / "truth/poses.csv", times[within], poses[within])
    T_utm_vehicle = T_world_imu[within] @ np.linalg.inv(simulation.T_vehicle_imu)
    T_utm_vehicle[:, :3, 3] += _UTM_ORIGIN_M
    _write_rows(folder / "global_pose.csv", times[within], T_utm_vehicle[:, :3].reshape(-1, 12))


def imu_times(simulation: Simulation) -> IntArray:
    """IMU stamps (N,) in ns, from before the first image to after the last; one on the first."""
    first, last = int(simulation.camera_ns[0]), int(simulation.camera_ns[-1])
    period_ns = round(1e9 / simulation.imu.rate_hz)
    before = int(_IMU_LEAD_S * simulation.imu.rate_hz)
    count = before + (last - first) // period_ns + int(_IMU_TAIL_S * simulation.imu.rate_hz) + 1
    return first + period_ns * (np.arange(count, dtype=np.int64) - before)


def _write_rows(path: Path, times: IntArray, values: FloatArray) -> None:
    """A line per row: the stamp as an integer, then the values with nine decimals."""
    lines = (
        f"{t}," + ",".join(f"{x:.9f}" for x in row) + "\n"
        for t, row in zip(times.tolist(), values.tolist(), strict=True)
    )
    path.write_text("".join(lines))


def _write_calibration(folder: Path, simulation: Simulation) -> None:
    rig = simulation.rig
    pair = _rectify(simulation)
    for side, name, camera in zip((0, 1), ("left", "right"), rig.cameras, strict=True):
        _write_camera(
            folder / f"{name}.yaml", name, camera, pair.rotation[side], pair.projection[side]
        )
    T_vehicle_cam0 = simulation.T_vehicle_imu @ rig.T_imu_cam0
    _write_mount(folder / "Vehicle2Stereo.txt", "Vehicle2Stereo", T_vehicle_cam0)
    _write_mount(folder / "Vehicle2IMU.txt", "Vehicle2IMU", simulation.T_vehicle_imu)


def _rectify(simulation: Simulation) -> _RectifiedPair:
    """OpenCV's rectification, from which readers get the right camera's pose."""
    left, right = simulation.rig.cameras
    T_cam1_cam0 = simulation.rig.T_cam1_cam0
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
