"""Calibration of a simulated rig as Kalibr writes it."""

from pathlib import Path
from typing import Any

import yaml

from ovmot.cameras.calibration import NOISE_KEYS
from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.sim.simulation import ImuModel


def check_rig(folder: Path, rig: StereoRig) -> None:
    """Raise `InputError` for a rig that a Kalibr chain cannot hold: one with skew."""
    for camera in rig.cameras:
        if camera.intrinsics[4] != 0.0:
            problem = f"Kalibr calibration cannot hold a skew of {camera.intrinsics[4]:g}"
            raise InputError.at(folder, problem, "use cameras without skew")


def write_chain(path: Path, rig: StereoRig) -> None:
    """`cam0`, `cam1` with `T_cam_imu`, and `timeshift_cam_imu`: t_imu = t_cam + shift."""
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
            "distortion_model": camera.lens.name,
            "intrinsics": camera.intrinsics[:4].tolist(),
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
            "timeshift_cam_imu": rig.time_offset_s,
        }
    values["cam1"]["T_cn_cnm1"] = rig.T_cam1_cam0.tolist()
    write_yaml(path, values)


def write_noise(path: Path, imu: ImuModel) -> None:
    """Kalibr's `imu.yaml`; nothing for an IMU without noise: readers refuse densities of zero."""
    noise = {key: getattr(imu.noise, name) for name, key in NOISE_KEYS.items()}
    if min(noise.values()) > 0.0:
        write_yaml(path, {**noise, "rostopic": "/imu0", "update_rate": imu.rate_hz})


def write_yaml(path: Path, values: dict[str, Any]) -> None:
    """Keys in their order, lists on one line."""
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")
