"""Configuration of OpenVINS as it is: `estimator_config.yaml` and the Kalibr chains it names.

Every key is mapped to a setting of ours, or says what ovmot does anyway, or is named in one
warning. docs/data.md has the table. Keys: the public documentation of OpenVINS, docs.openvins.com.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.datasets.calibration import (
    Calibration,
    CalibrationNode,
    load_calibration_yaml,
)
from ovmot.datasets.kalibr import read_kalibr_cameras, read_kalibr_noise
from ovmot.datasets.presets import given_max_gap_s
from ovmot.errors import InputError
from ovmot.settings import Settings
from ovmot.settings_file import load_settings, make_settings, read_yaml_mapping
from ovmot.text_files import StrPath

PLAIN = {
    "calib_cam_extrinsics": "calibration.extrinsics",
    "calib_cam_intrinsics": "calibration.intrinsics",
    "calib_cam_timeoffset": "filter.estimate_time_offset",
    "calib_imu_intrinsics": "calibration.imu_intrinsics",
    "calib_imu_g_sensitivity": "calibration.g_sensitivity",
    "max_clones": "filter.max_clones",
    "max_slam": "filter.max_landmarks",
    "max_msckf_in_update": "filter.max_features_per_update",
    "gravity_mag": "filter.gravity_mps2",
    "up_msckf_sigma_px": "filter.pixel_sigma",
    "up_msckf_chi2_multipler": "filter.chi2_multiplier",
    "up_slam_sigma_px": "filter.landmark_pixel_sigma",
    "try_zupt": "zero_velocity.enabled",
    "num_pts": "tracker.max_features",
    "fast_threshold": "tracker.fast_threshold",
}
"""Keys whose value is taken over as it stands, and our settings."""

WORDS = {
    "integration": (
        "filter.integration",
        {"discrete": "discrete", "rk4": "rk4", "analytical": "analytic"},
    ),
    "feat_rep_slam": (
        "filter.landmark_representation",
        {
            "GLOBAL_3D": "global_xyz",
            "GLOBAL_FULL_INVERSE_DEPTH": "global_inverse_depth",
            "ANCHORED_3D": "anchored_xyz",
            "ANCHORED_FULL_INVERSE_DEPTH": "anchored_inverse_depth",
            "ANCHORED_MSCKF_INVERSE_DEPTH": "anchored_msckf_inverse_depth",
            "ANCHORED_INVERSE_DEPTH_SINGLE": "anchored_single_inverse_depth",
        },
    ),
    "histogram_method": (
        "tracker.equalization",
        {"NONE": "none", "HISTOGRAM": "histogram", "CLAHE": "clahe"},
    ),
}
"""Keys whose words have other names here."""

ALWAYS = {
    "use_fej": True,
    "use_klt": True,
    "use_aruco": False,
    "downsample_cameras": False,
    "zupt_only_at_beginning": False,
    "init_dyn_use": True,
    "record_timing_information": True,
    "save_total_state": True,
}
"""Keys that, with this value, ask for what ovmot does anyway."""

_JOINT = {
    "use_stereo", "max_cameras", "use_rk4int", "use_imuavg",
    "init_window_time", "zupt_max_disparity", "use_mask", "mask0", "mask1",
    "relative_config_imu", "relative_config_imucam",
}  # fmt: skip
_YES_OR_NO = {"use_stereo", "use_rk4int", "use_imuavg", "init_dyn_use", "use_mask"}
_MARKS = PLAIN.keys() | WORDS.keys() | ALWAYS.keys() | _JOINT

_CAMERA_KEYS = {
    "T_imu_cam", "T_cam_imu", "T_cn_cnm1", "camera_model", "distortion_coeffs", "distortion_model",
    "intrinsics", "resolution", "skew", "timeshift_cam_imu",
}  # fmt: skip
_NOISE = "noise_density", "random_walk"
_IDENTITIES: dict[str, list[list[float]]] = {
    **dict.fromkeys(("Tw", "Ta", "R_IMUtoGYRO", "R_IMUtoACC"), np.eye(3).tolist()),
    "Tg": np.zeros((3, 3)).tolist(),
}


@dataclass(frozen=True, slots=True)
class RunConfig:
    """What `--config` says: settings, and, if it is OpenVINS's, calibration and masks.

    `mask_files` are those of the left and the right camera; `warnings` is for the user.
    """

    settings: Settings
    calibration: Calibration | None = None
    mask_files: tuple[Path | None, Path | None] = (None, None)
    warnings: tuple[str, ...] = ()

    @property
    def imu_max_gap_s(self) -> float | None:
        """The setting `imu.max_gap_s` where it was given."""
        return given_max_gap_s(self.settings)


def load_run_config(
    file: StrPath | None, overrides: Sequence[str] = (), *, need_imu_pose: bool = True
) -> RunConfig:
    """Settings of ours or of OpenVINS, recognised by the keys; `overrides` are `section.key=value`.

    `need_imu_pose`: whether OpenVINS's chain must say where the cameras are on the IMU.
    Raises `InputError` as `load_settings` does, and for chains that are missing or broken.
    """
    if file is None:
        return RunConfig(load_settings(None, overrides))
    path = Path(file)
    data = read_yaml_mapping(path)
    if not is_openvins(data):
        return RunConfig(load_settings(path, overrides))
    calibration, unused_in_chains = _read_chains(path, data, need_imu_pose)
    values, unused = translate(path, data)
    settings = make_settings(values, overrides, f"{path} (OpenVINS)")
    masks = _mask_files(path, data)
    parts = [f"{path}: {', '.join(unused)}"] if unused else []
    parts += [f"{file}: {', '.join(keys)}" for file, keys in unused_in_chains if keys]
    text = f"keys of OpenVINS that have no effect here: {'; '.join(parts)}"
    return RunConfig(settings, calibration, masks, (text,) if parts else ())


def is_openvins(data: Mapping[str, Any]) -> bool:
    """Are these keys of OpenVINS? Ours stand in sections."""
    return any(key in _MARKS for key in data) and not data.keys() & Settings.model_fields.keys()


def translate(path: Path, data: Mapping[str, Any]) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Our settings by section, and the keys of `data` that have no effect, in their order.

    Raises `InputError` for a word that is not known.
    """
    for key in sorted(_YES_OR_NO & data.keys()):
        if data[key] not in (True, False):  # any text would be true, be it "false"
            problem = f"'{key}': '{data[key]}' is neither true nor false"
            raise InputError.at(path, problem, "write it without quotation marks")
    flat: dict[str, Any] = {}
    used: set[str] = {"relative_config_imu", "relative_config_imucam", "use_mask"}
    for key, place in PLAIN.items():
        if key in data:
            flat[place] = data[key]
            used.add(key)
    for key, (place, words) in WORDS.items():
        if key not in data:
            continue
        if str(data[key]) not in words:
            problem = f"'{key}': '{data[key]}' is not known"
            raise InputError.at(path, problem, f"known: {', '.join(words)}")
        flat[place] = words[str(data[key])]
        used.add(key)
    used |= {key for key, value in ALWAYS.items() if data.get(key) is value}
    joint = _cameras(data), _integration(data), _start(data), _standstill(data)
    for values, keys in joint:
        flat |= values
        used |= keys
    if data.get("use_mask"):
        used |= {"mask0", "mask1"}
    sections: dict[str, dict[str, Any]] = {}
    for place, value in flat.items():
        section, _, name = place.partition(".")
        sections.setdefault(section, {})[name] = value
    return sections, [key for key in data if key not in used]


_Mapped = tuple[dict[str, Any], set[str]]


def _cameras(data: Mapping[str, Any]) -> _Mapped:
    """One camera is the left one; two are matched, or each goes by itself."""
    count, stereo = data.get("max_cameras", 2), data.get("use_stereo", True)
    if count not in (1, 2):
        return {}, set()
    matched = "stereo" if stereo else "each"
    return {"tracker.cameras": "left" if count == 1 else matched}, {"max_cameras", "use_stereo"}


def _integration(data: Mapping[str, Any]) -> _Mapped:
    """Keys of before `integration`, which wins; mean rates are what our `discrete` takes."""
    if "integration" in data or "use_rk4int" not in data:
        return {}, set()
    if data["use_rk4int"]:
        return {"filter.integration": "rk4"}, {"use_rk4int"}
    averaged = {"use_imuavg"} if data.get("use_imuavg") else set()
    return {"filter.integration": "discrete"}, {"use_rk4int"} | averaged


def _start(data: Mapping[str, Any]) -> _Mapped:
    """The window is that of dynamic initialization where OpenVINS would try it."""
    if "init_window_time" not in data:
        return {}, set()
    name = "motion_window_s" if data.get("init_dyn_use") else "window_s"
    return {f"initialization.{name}": data["init_window_time"]}, {"init_window_time"}


def _standstill(data: Mapping[str, Any]) -> _Mapped:
    """The disparity of a standstill; 0 has the IMU alone decide, which it never does here."""
    if not data.get("zupt_max_disparity"):
        return {}, set()
    return {"zero_velocity.pixel": data["zupt_max_disparity"]}, {"zupt_max_disparity"}


def _mask_files(path: Path, data: Mapping[str, Any]) -> tuple[Path | None, Path | None]:
    """The images beside the configuration that `mask0` and `mask1` name."""
    if not data.get("use_mask"):
        return None, None
    files = [path.parent / str(data[key]) if key in data else None for key in ("mask0", "mask1")]
    for key, file in zip(("mask0", "mask1"), files, strict=True):
        if file is not None and not file.is_file():
            raise InputError.at(path, f"'{key}': no such file {file}", "or set use_mask: false")
    return files[0], files[1]


def _read_chains(
    path: Path, data: Mapping[str, Any], need_imu_pose: bool
) -> tuple[Calibration | None, list[tuple[Path, list[str]]]]:
    """The calibration of the chains, and the keys in each of them that have no effect."""
    if "relative_config_imucam" not in data:
        return None, []
    chain = path.parent / str(data["relative_config_imucam"])
    unused = [(chain, _unused_of_cameras(load_calibration_yaml(chain)))]
    noise = None
    if "relative_config_imu" in data:
        file = path.parent / str(data["relative_config_imu"])
        noise = read_kalibr_noise(file)
        unused.append((file, _unused_of_imu(load_calibration_yaml(file))))
    return replace(read_kalibr_cameras(chain, need_imu_pose), imu_noise=noise), unused


def _unused_of_cameras(chain: CalibrationNode) -> list[str]:
    """Keys of `cam0` and `cam1`, each once, and further cameras."""
    keys: dict[str, None] = {}
    for name in chain.data:
        if name in ("cam0", "cam1"):
            keys |= dict.fromkeys(key for key in chain.child(name).data if key not in _CAMERA_KEYS)
        else:
            keys[str(name)] = None
    return list(keys)


def _unused_of_imu(chain: CalibrationNode) -> list[str]:
    """Keys of the IMU but for its noise, and but for scales and turns that change nothing."""
    imu = chain.child("imu0") if chain.has("imu0") else chain
    out = []
    for key, value in imu.data.items():
        nothing = key in _IDENTITIES and np.array_equal(imu.numbers(key, (3, 3)), _IDENTITIES[key])
        still = key == "time_offset" and value == 0.0
        if not (str(key).endswith(_NOISE) or key == "T_i_b" or nothing or still):
            out.append(str(key))
    return out
