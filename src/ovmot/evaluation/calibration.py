"""Errors of the online calibration against the true rig of a simulation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.outputs.run_reader import TIME_OFFSET, CalibrationDeviations

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


def true_deviations(prior: StereoRig, true: StereoRig) -> dict[str, float]:
    """What the deviations from the prior rig should become, by their names in `calibration.csv`."""
    out = {TIME_OFFSET: true.time_offset_s}
    rigs = zip(
        (prior.T_imu_cam0, prior.T_imu_cam1), (true.T_imu_cam0, true.T_imu_cam1), prior.cameras,
        true.cameras, strict=True,
    )  # fmt: skip
    for k, (T, T_true, camera, right) in enumerate(rigs):
        pose = (*so3.log(T[:3, :3].T @ T_true[:3, :3]), *(T_true[:3, 3] - T[:3, 3]))
        intrinsics = right.intrinsics[:4] - camera.intrinsics[:4]
        distortion = right.distortion - camera.distortion
        lens_columns = (*_FOCAL, *_CENTER, *(f"d{i}" for i in range(len(distortion))))
        out |= _named(f"cam{k}_pose_", (*_ROTATION, *_POSITION), pose)
        out |= _named(f"cam{k}_lens_", lens_columns, (*intrinsics, *distortion))
    return out


def calibration_errors(
    estimate: CalibrationDeviations | None, prior: StereoRig, true: StereoRig
) -> CalibrationErrors | None:
    """Errors of cameras and clock in a run that was given the rig `prior`.

    None where nothing was estimated. Coordinates whose truth is not known are left out.
    """
    if estimate is None:
        return None
    right = true_deviations(prior, true)
    known = [i for i, name in enumerate(estimate.names) if name in right]
    if not len(estimate.timestamp_ns) or not known:
        return None
    names = tuple(estimate.names[i] for i in known)
    error = np.array([right[name] for name in names]) - estimate.value[:, known]
    return CalibrationErrors(estimate.timestamp_ns, names, error, estimate.sigma[:, known])


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
