"""Checks of the IMU's values: units, gravity, range."""

import numpy as np

from ovmot.datasets.imu import FASTEST_RPS
from ovmot.doctor.report import Finding, Severity
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.types import ImuData

_GRAVITY = 9.81
_STANDARD_GRAVITY = 9.80665
_QUIET_S = 1.0
_NEAR, _FAR = 0.4, 4.0  # m/s² off gravity: a bias and a climb, and what no motion averages to
_STEEP_DEG = 45.0
_UPSIDE_DOWN_DEG = 135.0
_FLAT_TOP = 3  # samples in a row at exactly the same extreme
_LARGE = (1.0, 15.0)  # rad/s, m/s²: a small value that repeats is the resolution, not the range
_SATURATED_SHARE = 0.01


def check_accel_unit(imu: ImuData) -> Finding:
    """The unit, by the specific force in the quietest second, which is gravity but for the bias."""
    norm, check = quiet_force(imu), "accelerometer unit"
    says = f"the specific force is {norm:.4g} m/s² in the quietest second, gravity is {_GRAVITY}"
    off = abs(norm - _GRAVITY)
    if off <= _NEAR:
        return Finding(check, Severity.FINE, says)
    if off <= _FAR:
        remedy = "calibrate the accelerometer's scale and bias"
        return Finding(check, Severity.DOUBTFUL, says, remedy)
    return Finding(check, Severity.WRONG, says, _accel_remedy(norm), _accel_fix(norm))


def _is_g(norm: float) -> bool:
    return 0.6 < norm < 1.4


def _is_mg(norm: float) -> bool:
    return 600.0 < norm < 1400.0


def _accel_fix(norm: float) -> dict[str, float]:
    """The setting that makes the unit m/s², where it is plain."""
    if not (_is_g(norm) or _is_mg(norm)):
        return {}
    return {"recording.accel_scale": _STANDARD_GRAVITY * (1.0 if _is_g(norm) else 1e-3)}


def _accel_remedy(norm: float) -> str:
    if _is_g(norm):
        return f"the unit is g: multiply the IMU file's accelerations by {_STANDARD_GRAVITY}"
    if _is_mg(norm):
        return f"the unit is mg: multiply the IMU file's accelerations by {_STANDARD_GRAVITY}e-3"
    if norm < 0.6:
        return "gravity has been taken off: write the specific force as the sensor measured it"
    return "convert the IMU file's accelerations to m/s², gravity included"


def quiet_force(imu: ImuData) -> float:
    """Norm of the mean specific force, m/s², over the second in which it varies least."""
    seconds = 1e-9 * (imu.timestamp_ns - imu.timestamp_ns[0])
    # numbered anew: a hole of years would make as many empty seconds
    _, spans = np.unique(seconds // _QUIET_S, return_inverse=True)
    count = np.bincount(spans)
    mean, square = (
        np.stack([np.bincount(spans, x) for x in values.T], axis=1) / np.maximum(count, 1)[:, None]
        for values in (imu.accel, imu.accel**2)
    )
    variance = (square - mean**2).sum(1)
    whole = count >= 0.5 * count.max()
    quietest = int(np.argmin(np.where(whole, variance, np.inf)))
    return float(np.linalg.norm(mean[quietest]))


def check_gyro_range(imu: ImuData) -> Finding:
    """Whether the rates are possible at all; `time_offset` compares them with the images."""
    fastest = float(np.abs(imu.gyro).max())
    says = f"the gyroscope reads up to {fastest:.3g} rad/s ({np.degrees(fastest):.0f} °/s)"
    if fastest > FASTEST_RPS:
        remedy = "the unit is °/s: multiply the IMU file's rates by π/180"
        return Finding("gyroscope range", Severity.WRONG, says, remedy)
    return Finding("gyroscope range", Severity.FINE, says)


def check_gravity(imu: ImuData, R_imu_cam0: FloatArray, place: str) -> Finding:
    """Where up is in the left camera, by the mean specific force and the extrinsics.

    `place` says where `R_imu_cam0` (3, 3) is written.
    """
    found = held(imu, R_imu_cam0)
    if found is None:
        return Finding("gravity direction", Severity.UNKNOWN, "the IMU turns about too much")
    pitch, roll = found
    says = (
        f"by the extrinsics, the left camera looks {abs(pitch):.0f}°"
        f" {'up' if pitch > 0 else 'down'} and is rolled {abs(roll):.0f}°"
    )
    if abs(pitch) <= _STEEP_DEG and abs(roll) <= _STEEP_DEG:
        return Finding("gravity direction", Severity.FINE, says)
    remedy = (
        f"if the camera was held otherwise, correct {place}: a rotation may be written inverted"
    )
    if _is_upside_down(found):
        remedy = f"if it was not, the accelerometer is negated (recording.accel_scale), or {place}"
    return Finding("gravity direction", Severity.DOUBTFUL, says, remedy)


def held(imu: ImuData, R_imu_cam0: FloatArray) -> tuple[float, float] | None:
    """How the left camera is held by the mean specific force, deg: up (pitch) and rolled.

    None where the IMU turns about too much.
    """
    mean = imu.accel.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < 0.5 * float(np.linalg.norm(imu.accel, axis=1).mean()):
        return None
    up = R_imu_cam0.T @ mean / size
    pitch = float(np.degrees(np.arcsin(np.clip(up[2], -1.0, 1.0))))
    return pitch, float(np.degrees(np.arctan2(up[0], -up[1])))


def _is_upside_down(held_deg: tuple[float, float]) -> bool:
    pitch, roll = held_deg
    return abs(pitch) <= _STEEP_DEG and abs(roll) > _UPSIDE_DOWN_DEG


def check_accel_sign(imu: ImuData, R_imu_cam0: FloatArray) -> Finding:
    """Does gravity point upwards in the picture? By the extrinsics `R_imu_cam0` (3, 3)."""
    check, found = "accelerometer sign", held(imu, R_imu_cam0)
    if found is None or not _is_upside_down(found):
        return Finding(check, Severity.FINE, "gravity points down in the picture")
    says = f"the left camera hangs upside down (rolled {abs(found[1]):.0f}°) by the accelerometer"
    remedy = "if it does not, the accelerometer is negated"
    return Finding(check, Severity.DOUBTFUL, says, remedy, {"recording.accel_scale": -1.0})


def check_imu_saturation(imu: ImuData) -> list[Finding]:
    """Whether samples stand at the end of the sensor's range, or do not change at all."""
    findings = []
    for name, values, large in (
        ("gyroscope", imu.gyro, _LARGE[0]),
        ("accelerometer", imu.accel, _LARGE[1]),
    ):
        stuck = len(values) > 10 and np.any(np.ptp(values, axis=0) == 0.0)
        at_end = at_range_end(values, large)
        share = float(at_end.any(axis=1).mean())
        check = f"{name} saturation"
        if stuck:
            says, remedy = f"an axis of the {name} never changes", "check the IMU file's columns"
            findings.append(Finding(check, Severity.WRONG, says, remedy))
        elif share > 0.0:
            worst = float(np.abs(values[at_end]).max())
            says = f"{share:.2%} of the samples stand at the range's end, {worst:.4g}"
            severity = Severity.WRONG if share > _SATURATED_SHARE else Severity.DOUBTFUL
            findings.append(Finding(check, severity, says, "set a wider range, or damp the IMU"))
        else:
            says = f"no sample of the {name} stands at the range's end"
            findings.append(Finding(check, Severity.FINE, says))
    return findings


def at_range_end(values: FloatArray, large: float) -> BoolArray:
    """Which of the values (N, 3) belong to a run of equal extremes, by axis, of size >= `large`."""
    out = np.zeros(values.shape, dtype=np.bool_)
    for axis, x in enumerate(values.T):
        for extreme in (x.min(), x.max()):
            if abs(extreme) < large:
                continue
            hit = x == extreme
            edges = np.flatnonzero(np.diff(np.concatenate([[0], hit.astype(np.int8), [0]])))
            runs = edges.reshape(-1, 2)
            for start, stop in runs[runs[:, 1] - runs[:, 0] >= _FLAT_TOP]:
                out[start:stop, axis] = True
    return out
