"""Is the calibration found? What was estimated online against the true rig of a simulation."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.outputs.run_reader import read_table

TIME_OFFSET = "time_offset_s"
_ROTATION, _POSITION = ("rx", "ry", "rz"), ("x", "y", "z")
_FOCAL, _CENTER = ("fx", "fy"), ("cx", "cy")
_SETTLED_S = 5.0


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """Errors (N, C) of the named coordinates at N stamps, and their stated 1-sigma (N, C)."""

    timestamp_ns: IntArray
    names: tuple[str, ...]
    error: FloatArray
    sigma: FloatArray


def true_deviations(told: StereoRig, true: StereoRig) -> dict[str, float]:
    """What the deviations from the told rig should become, by their names in `calibration.csv`."""
    out = {TIME_OFFSET: true.time_offset_s}
    rigs = zip(
        (told.T_imu_cam0, told.T_imu_cam1), (true.T_imu_cam0, true.T_imu_cam1), told.cameras,
        true.cameras, strict=True,
    )  # fmt: skip
    for k, (T, T_true, camera, right) in enumerate(rigs):
        pose = (*so3.log(T[:3, :3].T @ T_true[:3, :3]), *(T_true[:3, 3] - T[:3, 3]))
        lens = right.intrinsics[:4] - camera.intrinsics[:4]
        bent = right.distortion - camera.distortion
        of_lens = (*_FOCAL, *_CENTER, *(f"d{i}" for i in range(len(bent))))
        out |= _named(f"cam{k}_pose_", (*_ROTATION, *_POSITION), pose)
        out |= _named(f"cam{k}_lens_", of_lens, (*lens, *bent))
    return out


def calibration_errors(run: Path, told: StereoRig, true: StereoRig) -> CalibrationErrors | None:
    """Errors of cameras and clock in a run that was given the rig `told`; None without an estimate.

    The clock, which has no sigma where it is held, counts where it is estimated. Raises
    `InputError` for tables that cannot be used.
    """
    path = run / "calibration.csv"
    if not path.is_file() or path.stat().st_size == 0:
        return None
    with path.open(encoding="utf-8") as file:
        columns = file.readline().strip().split(",")
    right = true_deviations(told, true)
    names = tuple(name for name in columns if name in right)
    table = read_table(path, (*names, *(f"std_{name}" for name in names)))
    clock = read_table(run / "state.csv", (TIME_OFFSET, f"std_{TIME_OFFSET}")).values
    estimate, sigma = np.split(table.values, 2, axis=1)
    if (clock[:, 1] > 0.0).all():
        names = (*names, TIME_OFFSET)
        estimate, sigma = np.c_[estimate, clock[:, 0]], np.c_[sigma, clock[:, 1]]
    if not len(table.timestamp_ns) or not names:
        return None
    error = np.array([right[name] for name in names]) - estimate
    return CalibrationErrors(table.timestamp_ns, names, error, sigma)


def calibration_scalars(errors: CalibrationErrors) -> dict[str, float | None]:
    """Errors at the end, the worse camera's; the worst of all coordinates in sigmas; and the share
    of errors inside 3 sigma, at the end and over all frames from 5 s after the start on.
    """
    last = dict(zip(errors.names, errors.error[-1], strict=True))
    settled = errors.timestamp_ns >= errors.timestamp_ns[0] + round(1e9 * _SETTLED_S)
    sigmas = np.abs(errors.error) / errors.sigma
    inside = sigmas < 3.0

    def worst(part: str, labels: Sequence[str]) -> float | None:
        known = [
            float(np.linalg.norm([last[f"cam{k}_{part}_{label}"] for label in labels]))
            for k in (0, 1)
            if f"cam{k}_{part}_{labels[0]}" in last
        ]
        return max(known, default=None)

    rotation, clock = worst("pose", _ROTATION), last.get(TIME_OFFSET)
    return {
        "calibration_rotation_deg": None if rotation is None else float(np.degrees(rotation)),
        "calibration_position_m": worst("pose", _POSITION),
        "calibration_focal_px": worst("lens", _FOCAL),
        "calibration_center_px": worst("lens", _CENTER),
        "calibration_time_offset_ms": None if clock is None else 1e3 * abs(float(clock)),
        "calibration_worst_sigmas": float(sigmas[-1].max()),
        "calibration_end_inside_3_sigma": float(inside[-1].mean()),
        "calibration_inside_3_sigma": float(inside[settled].mean()) if settled.any() else None,
    }


def _named(prefix: str, labels: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    return {prefix + label: float(v) for label, v in zip(labels, values, strict=True)}
