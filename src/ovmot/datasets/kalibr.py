"""Calibration files of Kalibr and of OpenVINS (`kalibr_imucam_chain.yaml`), read and written."""

from collections.abc import Sequence
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
    calibrated_camera,
    kalibr_keys,
    load_calibration_yaml,
    make_rig,
    read_imu_noise,
)
from ovmot.errors import CalibrationError, InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuNoise

CHAIN_FILE = "kalibr_imucam_chain.yaml"
IMU_FILE = "kalibr_imu_chain.yaml"
_MAX_CLOCK_DIFFERENCE_S = 0.002
_FARTHEST_M = 20.0  # of a camera from its IMU: more is millimetres, or another origin
_SAME_M, _SAME_DEG = 1e-3, 0.05  # what rounding may do; half a pixel of a common camera


def read_kalibr(
    path: Path, left: str | None = None, right: str | None = None, need_imu_pose: bool = True
) -> Calibration:
    """Rig and IMU noise of a chain file, or of a folder that holds `kalibr_imucam_chain.yaml`.

    The noise comes from `kalibr_imu_chain.yaml` beside it and is None without that file. `left`,
    `right` and `need_imu_pose`: see `read_kalibr_cameras`. Raises `CalibrationError` with file, key
    and remedy.
    """
    chain = _chain_file(path)
    cameras = read_kalibr_cameras(chain, left, right, need_imu_pose)
    return replace(cameras, imu_noise=_noise_beside(chain))


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the left camera is on the IMU (4, 4), the clock between them, the IMU's noise."""

    T_imu_cam0: FloatArray
    time_offset_s: float
    imu_noise: ImuNoise | None


def is_mount(path: Path) -> bool:
    """Does a chain say of `cam0` alone where it is, and not what it is? Raises
    `CalibrationError`."""
    chain = load_calibration_yaml(_chain_file(path))
    return not chain.has("cam1") and chain.has("cam0") and not chain.child("cam0").has("intrinsics")


def read_kalibr_mount(path: Path) -> Mount:
    """What a chain says of `cam0`'s place and clock; raises `CalibrationError`."""
    chain = _chain_file(path)
    cam0 = load_calibration_yaml(chain).child("cam0")
    T_imu_cam0 = _pose_on_imu(cam0, None)
    _refuse_far(cam0, T_imu_cam0)
    return Mount(T_imu_cam0, _time_offset(cam0, cam0), _noise_beside(chain))


def read_kalibr_rig(path: Path) -> StereoRig:
    """The rig of a chain, without noise; see `read_kalibr_cameras`."""
    return read_kalibr_cameras(path).rig


def read_kalibr_cameras(
    path: Path, left: str | None = None, right: str | None = None, need_imu_pose: bool = True
) -> Calibration:
    """The rig of a chain's cameras, placed by `T_cam_imu`, `T_imu_cam` or `T_cn_cnm1`; no noise.

    `left`, `right`: which cameras, by name or `rostopic`; else the first one, and the next one or
    that which the first names in `cam_overlaps`. A chain of one makes a rig of one.
    `timeshift_cam_imu` is Kalibr's: t_imu = t_cam + shift, seconds, absent means 0. Where two
    neighbours have both poses on the IMU and `T_cn_cnm1`, and they differ, `T_cn_cnm1` is taken and
    a note says so. A chain without poses on the IMU is an error if `need_imu_pose`, else the left
    camera stands for the IMU.
    """
    chain = load_calibration_yaml(path)
    if chain.has("camera_matrix") and not chain.has("cam0"):
        problem = "is a ROS camera file of one camera"
        raise CalibrationError.at(path, problem, "write both cameras into a chain (cam0, cam1)")
    chain.child("cam0")  # which may be missing
    names = _camera_names(chain)
    chosen = _chosen(chain, names, left, right)
    nodes = [chain.child(name) for name in chosen]
    if need_imu_pose or _is_on_imu(chain, names, chosen[0]):
        poses, notes = _poses_on_imu(chain, names, chosen)
    else:
        T_first = [_pose_on_first(chain, names, name) for name in chosen]
        poses = [se3.inverse(T_first[0]) @ T for T in T_first]
        notes = (f"{path}: no pose on the IMU: the given poses are those of the left camera",)
    cameras = [calibrated_camera(node, "distortion_coeffs") for node in nodes]
    if need_imu_pose:
        _refuse_far(nodes[0], poses[0])
    rig = make_rig(path, cameras, poses, _time_offset(nodes[0], nodes[-1]))
    if len(names) > 2:
        note = (
            f"{path}: {len(names)} cameras, of which {chosen[0]} is taken as the left and"
            f" {chosen[1]} as the right one (--left, --right)"
        )
        notes = (note, *notes)
    topics = [str(node.value("rostopic")) if node.has("rostopic") else None for node in nodes]
    return Calibration(rig, None, chosen, tuple(topics), notes)


def _camera_names(chain: CalibrationNode) -> list[str]:
    """`cam0`, `cam1`, ... so far as they go."""
    names: list[str] = []
    while chain.has(f"cam{len(names)}"):
        names.append(f"cam{len(names)}")
    if any(_is_camera(key) and key not in names for key in chain.data):
        chain.child(f"cam{len(names)}")  # which says that it is missing
    return names


def _is_camera(name: object) -> bool:
    return isinstance(name, str) and name.startswith("cam") and name[3:].isdecimal()


def _chosen(
    chain: CalibrationNode, names: Sequence[str], left: str | None, right: str | None
) -> tuple[str, ...]:
    """The names of the cameras to take: two, or the one that there is."""
    by_topic = {str(chain.child(name).data.get("rostopic")).strip("/"): name for name in names}

    def named(asked: str | None) -> str | None:
        if _is_camera(asked) and asked not in names:
            chain.child(str(asked))  # which says that it is missing
        return asked if asked in names else by_topic.get((asked or "").strip("/"))

    if len(names) == 1:
        return tuple(names)
    second = named(right)
    first = named(left) or next(name for name in names if name != second)
    if second is None:
        overlaps = chain.child(first).data.get("cam_overlaps")
        beside = [f"cam{k}" for k in overlaps] if isinstance(overlaps, list) else []
        after = [*names[names.index(first) + 1 :], *names]
        second = next(name for name in (*beside, *after) if name in names and name != first)
    if first == second:
        raise chain.fail(first, "this camera is both left and right", "name two cameras")
    return first, second


def _has_pose(camera: CalibrationNode) -> bool:
    return camera.has("T_imu_cam") or camera.has("T_cam_imu")


def _is_on_imu(chain: CalibrationNode, names: Sequence[str], name: str) -> bool:
    """Whether a camera's place on the IMU follows, through those before it if need be."""
    camera, k = chain.child(name), names.index(name)
    through_chain = k > 0 and camera.has("T_cn_cnm1")
    return _has_pose(camera) or (through_chain and _is_on_imu(chain, names, names[k - 1]))


def _pose_on_first(chain: CalibrationNode, names: Sequence[str], name: str) -> FloatArray:
    """T_cam0_cam by `T_cn_cnm1` alone."""
    T_cam0_cam = np.eye(4)
    for before in names[1 : names.index(name) + 1]:
        T_cam0_cam = T_cam0_cam @ se3.inverse(chain.child(before).transform("T_cn_cnm1"))
    return T_cam0_cam


def _poses_on_imu(
    chain: CalibrationNode, names: Sequence[str], chosen: Sequence[str]
) -> tuple[list[FloatArray], tuple[str, ...]]:
    """T_imu_cam of the chosen cameras, and a note where two keys contradict each other."""
    poses = {name: _pose_in_chain(chain, names, name) for name in chosen}
    earlier, later = min(chosen, key=names.index), max(chosen, key=names.index)
    notes: tuple[str, ...] = ()
    if names.index(later) == names.index(earlier) + 1:
        poses[later], notes = _pose_beside(chain, later, poses[later], poses[earlier])
    return [poses[name] for name in chosen], notes


def _pose_in_chain(chain: CalibrationNode, names: Sequence[str], name: str) -> FloatArray:
    """T_imu_cam of a camera, through those before it where it says no more."""
    camera, k = chain.child(name), names.index(name)
    before = None
    if k > 0 and not _has_pose(camera):
        before = _pose_in_chain(chain, names, names[k - 1])
    return _pose_on_imu(camera, before)


def _pose_beside(
    chain: CalibrationNode, name: str, own: FloatArray, T_imu_previous: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """T_imu_cam of a camera beside its neighbour's, and a note where two keys differ.

    Then that one is taken which was calibrated between the cameras: the depth of all points hangs
    on it.
    """
    camera = chain.child(name)
    if not (_has_pose(camera) and camera.has("T_cn_cnm1")):
        return own, ()
    by_previous = T_imu_previous @ se3.inverse(camera.transform("T_cn_cnm1"))
    apart = se3.inverse(own) @ by_previous
    apart_m = float(np.linalg.norm(apart[:3, 3]))
    apart_deg = float(np.degrees(np.linalg.norm(so3.log(apart[:3, :3]))))
    if apart_m < _SAME_M and apart_deg < _SAME_DEG:
        return own, ()
    key = "T_imu_cam" if camera.has("T_imu_cam") else "T_cam_imu"
    note = (
        f"{camera.path}: {name}.{key} and {name}.T_cn_cnm1 differ by {1e3 * apart_m:.3g} mm and"
        f" {apart_deg:.2g} degrees: T_cn_cnm1 is used, since it was calibrated between the cameras"
    )
    return by_previous, (note,)


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
    if T_imu_previous is not None:
        remedy = "add it: kalibr_calibrate_cameras writes it"
        raise camera.fail("T_cn_cnm1", "the pose against the camera before is missing", remedy)
    by = "kalibr_calibrate_imu_camera writes it"
    remedy = f"add T_cam_imu ({by}) or T_imu_cam, or run it with --ego poses FILE"
    raise camera.fail("T_cam_imu", "the camera's pose on the IMU is missing", remedy)


def _refuse_far(left: CalibrationNode, T_imu_left: FloatArray) -> None:
    """Raise `CalibrationError` where the left camera is too far from the IMU to be on one rig."""
    apart_m = float(np.linalg.norm(T_imu_left[:3, 3]))
    if apart_m > _FARTHEST_M:
        key = "T_imu_cam" if left.has("T_imu_cam") else "T_cam_imu"
        problem = f"the left camera stands {apart_m:.4g} m from the IMU"
        raise left.fail(key, problem, "translations are in metres")


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

    Of a monocular rig `cam0` alone. A skew is written as `skew`, a key that only ovmot reads.
    """
    values = {}
    cameras = (
        ("cam0", 1, rig.cam0, rig.T_imu_cam0),
        ("cam1", 0, rig.cam1, rig.T_imu_cam1),
    )[: rig.n_cameras]
    for name, other, camera, T_imu_cam in cameras:
        values[name] = {
            "T_cam_imu": se3.inverse(T_imu_cam).tolist(),
            "cam_overlaps": [other][: rig.n_cameras - 1],
            **kalibr_keys(camera),
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
            "timeshift_cam_imu": rig.time_offset_s,
        }
        if camera.intrinsics[4] != 0.0:
            values[name]["skew"] = float(camera.intrinsics[4])
    if rig.n_cameras == 2:
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
