"""Calibration files of Kalibr and of OpenVINS (`kalibr_imucam_chain.yaml`), read and written."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.calibration import (
    NOISE_KEYS,
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
    make_rig,
    read_imu_noise,
    read_pinhole,
)
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuNoise

CHAIN_FILE = "kalibr_imucam_chain.yaml"
IMU_FILE = "kalibr_imu_chain.yaml"
_MAX_CLOCK_DIFFERENCE_S = 0.002
_SAME_M, _SAME_DEG = 1e-3, 0.05  # what rounding may do; half a pixel of a common camera


def read_kalibr(path: Path, need_imu_pose: bool = True) -> Calibration:
    """Rig and IMU noise of a chain file, or of a folder that holds `kalibr_imucam_chain.yaml`.

    The noise comes from `kalibr_imu_chain.yaml` beside it and is None without that file.
    `need_imu_pose`: see `read_kalibr_cameras`. Raises `CalibrationError` with file, key and remedy.
    """
    chain = _chain_file(path)
    return replace(read_kalibr_cameras(chain, need_imu_pose), imu_noise=_noise_beside(chain))


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the left camera is on the IMU (4, 4), the clock between them, the IMU's noise."""

    T_imu_cam0: FloatArray
    time_offset_s: float
    imu_noise: ImuNoise | None


def is_mount(path: Path) -> bool:
    """Does a chain hold `cam0` alone: where it is, but no rig? Raises `CalibrationError`."""
    return not load_calibration_yaml(_chain_file(path)).has("cam1")


def read_kalibr_mount(path: Path) -> Mount:
    """What a chain says of `cam0`'s place and clock; raises `CalibrationError`."""
    chain = _chain_file(path)
    cam0 = load_calibration_yaml(chain).child("cam0")
    return Mount(_pose_on_imu(cam0, None), _time_offset(cam0, cam0), _noise_beside(chain))


def read_kalibr_cameras(path: Path, need_imu_pose: bool = True) -> Calibration:
    """The rig of `cam0` and `cam1`, placed by `T_cam_imu`, `T_imu_cam` or `T_cn_cnm1`; no noise.

    `timeshift_cam_imu` is Kalibr's: t_imu = t_cam + shift, seconds, absent means 0. Where `cam1`
    has both a pose on the IMU and `T_cn_cnm1`, and they differ, `T_cn_cnm1` is taken and a note
    says so. A chain without poses on the IMU is an error if `need_imu_pose`, else the left camera
    stands for the IMU.
    """
    node = load_calibration_yaml(path)
    cam0, cam1 = node.child("cam0"), node.child("cam1")
    if need_imu_pose or _has_pose(cam0):
        T_imu_cam0 = _pose_on_imu(cam0, None)
        T_imu_cam1, note = _pose_of_right(cam1, T_imu_cam0)
    else:
        T_imu_cam0, T_imu_cam1 = np.eye(4), se3.inverse(cam1.transform("T_cn_cnm1"))
        note = f"{path}: no pose on the IMU: the given poses are those of the left camera"
    cameras = read_pinhole(cam0, "distortion_coeffs"), read_pinhole(cam1, "distortion_coeffs")
    rig = make_rig(path, cameras, (T_imu_cam0, T_imu_cam1), _time_offset(cam0, cam1))
    return Calibration(rig, None, () if note is None else (note,))


def _has_pose(camera: CalibrationNode) -> bool:
    return camera.has("T_imu_cam") or camera.has("T_cam_imu")


def _pose_of_right(cam1: CalibrationNode, T_imu_cam0: FloatArray) -> tuple[FloatArray, str | None]:
    """T_imu_cam1, and a note where two keys contradict each other.

    Then that one is taken which was calibrated between the cameras: the depth of all points hangs
    on it.
    """
    own = _pose_on_imu(cam1, T_imu_cam0)
    if not (_has_pose(cam1) and cam1.has("T_cn_cnm1")):
        return own, None
    by_left = T_imu_cam0 @ se3.inverse(cam1.transform("T_cn_cnm1"))
    apart = se3.inverse(own) @ by_left
    apart_m = float(np.linalg.norm(apart[:3, 3]))
    apart_deg = float(np.degrees(np.linalg.norm(so3.log(apart[:3, :3]))))
    if apart_m < _SAME_M and apart_deg < _SAME_DEG:
        return own, None
    key = "T_imu_cam" if cam1.has("T_imu_cam") else "T_cam_imu"
    note = (
        f"{cam1.path}: cam1.{key} and cam1.T_cn_cnm1 differ by {1e3 * apart_m:.3g} mm and"
        f" {apart_deg:.2g} degrees: T_cn_cnm1 is used, since it was calibrated between the cameras"
    )
    return by_left, note


def read_kalibr_noise(path: Path) -> ImuNoise:
    """Noise densities of an IMU chain file (`imu0:`) or of Kalibr's plain `imu.yaml`."""
    node = load_calibration_yaml(path)
    imu = node.child("imu0") if node.has("imu0") else node
    if imu.has("T_i_b") and np.abs(imu.transform("T_i_b") - np.eye(4)).max() > 1e-6:
        remedy = "give the cameras relative to this IMU"
        raise imu.fail("T_i_b", "the IMU is not the body frame", remedy)
    return read_imu_noise(imu)


def _chain_file(path: Path) -> Path:
    return path / CHAIN_FILE if path.is_dir() else path


def _noise_beside(chain: Path) -> ImuNoise | None:
    imu = chain.with_name(IMU_FILE)
    return read_kalibr_noise(imu) if imu.exists() else None


def _pose_on_imu(camera: CalibrationNode, T_imu_previous: FloatArray | None) -> FloatArray:
    """T_imu_cam of a camera, from whichever key says it."""
    if camera.has("T_imu_cam"):
        return camera.transform("T_imu_cam")
    if camera.has("T_cam_imu"):
        return se3.inverse(camera.transform("T_cam_imu"))
    if T_imu_previous is not None and camera.has("T_cn_cnm1"):
        return T_imu_previous @ se3.inverse(camera.transform("T_cn_cnm1"))
    remedy = "add T_cam_imu or T_imu_cam, or run it with --ego poses FILE"
    raise camera.fail("T_cam_imu", "the camera's pose is missing", remedy)


def _time_offset(cam0: CalibrationNode, cam1: CalibrationNode) -> float:
    key = "timeshift_cam_imu"
    first, second = (cam.number(key) if cam.has(key) else None for cam in (cam0, cam1))
    if first is not None and second is not None and abs(first - second) > _MAX_CLOCK_DIFFERENCE_S:
        raise cam1.fail(
            key,
            f"{second:g} s, but {first:g} s for cam0",
            "the two cameras of a rig are exposed together",
        )
    return first if first is not None else second or 0.0


def check_rig(folder: Path, rig: StereoRig) -> None:
    """Raise `InputError` for a rig that Kalibr's own files cannot hold: one with skew."""
    for camera in rig.cameras:
        if camera.intrinsics[4] != 0.0:
            problem = f"Kalibr calibration cannot hold a skew of {camera.intrinsics[4]:g}"
            raise InputError.at(folder, problem, "use cameras without skew")


def write_chain(path: Path, rig: StereoRig) -> None:
    """`cam0`, `cam1` with `T_cam_imu`, and `timeshift_cam_imu`: t_imu = t_cam + shift.

    A skew is written as `skew`, a key that only ovmot reads.
    """
    values = {}
    for name, other, camera, T_imu_cam in (
        ("cam0", 1, rig.cam0, rig.T_imu_cam0),
        ("cam1", 0, rig.cam1, rig.T_imu_cam1),
    ):
        values[name] = {
            "T_cam_imu": se3.inverse(T_imu_cam).tolist(),
            "cam_overlaps": [other],
            "camera_model": "pinhole",
            "distortion_coeffs": camera.distortion.tolist(),
            "distortion_model": camera.model.name,
            "intrinsics": camera.intrinsics[:4].tolist(),
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
            "timeshift_cam_imu": rig.time_offset_s,
        }
        if camera.intrinsics[4] != 0.0:
            values[name]["skew"] = float(camera.intrinsics[4])
    values["cam1"]["T_cn_cnm1"] = rig.T_cam1_cam0.tolist()
    write_yaml(path, values)


def write_imu_chain(path: Path, imu_noise: ImuNoise, rate_hz: float) -> None:
    """`kalibr_imu_chain.yaml` as OpenVINS has it: `imu0`, the body frame, with its noise."""
    imu0 = {
        "T_i_b": np.eye(4).tolist(),
        **{key: getattr(imu_noise, name) for name, key in NOISE_KEYS.items()},
        "model": "calibrated",
        "rostopic": "/imu0",
        "time_offset": 0.0,
        "update_rate": rate_hz,
    }
    write_yaml(path, {"imu0": imu0})


def write_noise(path: Path, imu_noise: ImuNoise, rate_hz: float) -> None:
    """Kalibr's `imu.yaml`; nothing for an IMU without noise: readers refuse densities of zero."""
    noise = {key: getattr(imu_noise, name) for name, key in NOISE_KEYS.items()}
    if min(noise.values()) > 0.0:
        write_yaml(path, {**noise, "rostopic": "/imu0", "update_rate": rate_hz})


def write_yaml(path: Path, values: dict[str, Any]) -> None:
    """Keys in their order, lists on one line."""
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")
