"""Gyroscope against images: the clocks' offset, the gyroscope's unit, its axes on the camera.

Over each pair of frames the left camera's rotation rate c is compared with the gyroscope's mean
rate g(lag), taken `lag` later. They should differ by the rotation between camera and IMU only; but
c = B g(lag) + b is fitted with any matrix B, for every lag, so that a wrong unit, sign or rotation
does not hide the lag. The lag is where the fit is best; unit and axes then follow from B.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.doctor.camera_rotations import CameraRotations
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Finding, Severity
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.clock_offset import integrated_rates
from ovmot.types import ImuData

SEARCH_S, STEP_S = 0.4, 0.005
_LEAST_PAIRS = 15
_LEAST_RATE_RPS = 0.01
_NOISE_RPS = 0.02  # what far points and passing bodies can make of a rig that stands
_LEAST_AGREEMENT = 0.5  # share of the camera's turning that the gyroscope explains
_SURE_S = 0.005  # a lag whose standard deviation is greater is not reported
_SURE_RAD = 0.015  # an axis of turning that is seen less surely is not used
_SIGMAS = 4.0
_FOUND_S = 0.15  # a start in motion finds an offset up to this
_OFF_DEG = (4.0, 15.0)
_SCALE_OFF = (0.1, 0.3)
_DEGREE = 180.0 / np.pi


@dataclass(frozen=True, slots=True)
class GyroFit:
    """The best lag and its standard deviation, s; the `agreement` there, the share of the camera's
    turning that is explained; the camera's rms `rate_rps`, mean taken off; the `axes` (K, 3) about
    which the gyroscope turns enough, the main one first, and what B makes of them (K, 3), in the
    camera's axes."""

    lag_s: float
    lag_std_s: float
    agreement: float
    rate_rps: float
    axes: FloatArray
    images_of_axes: FloatArray

    @property
    def is_sure(self) -> bool:
        """Whether the lag is known well enough to be used."""
        return self.agreement >= _LEAST_AGREEMENT and self.lag_std_s <= _SURE_S


def fit_gyro(turns: CameraRotations, imu: ImuData, offset_s: float) -> GyroFit | None:
    """Fit camera and gyroscope over all lags; `offset_s` is the calibration's t_imu - t_cam.

    None with fewer than 15 pairs of frames that the IMU covers at every lag.
    """
    origin = int(imu.timestamp_ns[0])
    at = _seconds(imu.timestamp_ns, origin)
    start, end = (_seconds(ns, origin) + offset_s for ns in (turns.start_ns, turns.end_ns))
    use = np.isfinite(turns.rotation[:, 0])
    use &= (start - SEARCH_S > at[0]) & (end + SEARCH_S < at[-1])
    if use.sum() < _LEAST_PAIRS:
        return None
    start, end = start[use], end[use]
    camera = _centred(turns.rotation[use] / (end - start)[:, None])
    angle = integrated_rates(at, imu.gyro)
    lags = np.linspace(-SEARCH_S, SEARCH_S, 2 * round(SEARCH_S / STEP_S) + 1)
    left = np.array([_left_over(camera, _mean_rates(at, angle, start + s, end + s)) for s in lags])
    lag = _lowest(lags, left)
    gyro = _centred(_mean_rates(at, angle, start + lag, end + lag))
    B = np.linalg.lstsq(gyro, camera, rcond=None)[0].T
    residual = camera - gyro @ B.T
    slope = (
        _mean_rates(at, angle, start + lag + STEP_S, end + lag + STEP_S)
        - _mean_rates(at, angle, start + lag - STEP_S, end + lag - STEP_S)
    ) @ B.T / (2.0 * STEP_S)  # fmt: skip
    noise = float((residual**2).mean())
    _, size, axes = np.linalg.svd(gyro, full_matrices=False)
    axes = axes[size >= min(np.sqrt(noise) / _SURE_RAD, size[0])]
    return GyroFit(
        lag_s=lag,
        lag_std_s=float(np.sqrt(noise / max(float((_centred(slope) ** 2).sum()), 1e-300))),
        agreement=1.0 - float((residual**2).sum() / max(float((camera**2).sum()), 1e-300)),
        rate_rps=float(np.sqrt((camera**2).sum(1).mean())),
        axes=axes,
        images_of_axes=axes @ B.T,
    )


def _seconds(timestamp_ns: IntArray, origin_ns: int) -> FloatArray:
    return np.asarray(1e-9 * (timestamp_ns - origin_ns), dtype=np.float64)


def _mean_rates(
    at: FloatArray, angle: FloatArray, start: FloatArray, end: FloatArray
) -> FloatArray:
    turned = [np.interp(end, at, a) - np.interp(start, at, a) for a in angle.T]
    return np.stack(turned, axis=1) / (end - start)[:, None]


def _centred(values: FloatArray) -> FloatArray:
    centred: FloatArray = values - values.mean(axis=0)
    return centred


def _left_over(camera: FloatArray, gyro: FloatArray) -> float:
    """Squared rest of the camera's rates (N, 3) after the best linear fit to the gyroscope's."""
    gyro = _centred(gyro)
    B = np.linalg.lstsq(gyro, camera, rcond=None)[0]
    return float(((camera - gyro @ B) ** 2).sum())


def _lowest(lags: FloatArray, left: FloatArray) -> float:
    """The lag of the least rest, between the samples by a parabola through three of them."""
    i = int(np.argmin(left))
    if i in (0, len(lags) - 1):
        return float(lags[i])
    a, b, c = left[i - 1 : i + 2]
    curvature = a - 2.0 * b + c
    return float(lags[i] + (0.5 * STEP_S * (a - c) / curvature if curvature > 0.0 else 0.0))


def check_gyro(
    found: GyroFit | None, R_imu_cam0: FloatArray, offset_s: float, sigma_s: float,
    locations: Locations,
) -> list[Finding]:  # fmt: skip
    """Time offset, unit and axes of the gyroscope; `offset_s` and `R_imu_cam0` as calibrated.

    `sigma_s`: the setting `filter.time_offset_sigma_s`.
    """
    checks = "time offset", "gyroscope unit", "camera on IMU"
    if found is None:
        says = "too few frames whose rotation the images tell"
        return [Finding(check, Severity.UNKNOWN, says) for check in checks]
    agrees = found.agreement >= _LEAST_AGREEMENT
    if found.rate_rps < (_LEAST_RATE_RPS if agrees else _NOISE_RPS):
        says = f"the rig hardly turns ({found.rate_rps:.2g} rad/s by the images)"
        return [Finding(check, Severity.UNKNOWN, says) for check in checks]
    if not agrees:
        says = (
            f"the gyroscope explains {found.agreement:.0%} of the camera's turning"
            f" ({found.rate_rps:.2g} rad/s) at any offset up to {SEARCH_S} s"
        )
        remedy = f"check the columns and the stamps of {locations.imu}"
        return [Finding("gyroscope and images", Severity.DOUBTFUL, says, remedy)]
    return [
        _time_offset(found, offset_s, sigma_s),
        _gyro_unit(found, locations),
        _mount(found, R_imu_cam0, locations),
    ]


def _time_offset(found: GyroFit, offset_s: float, sigma_s: float) -> Finding:
    lag, std = found.lag_s, found.lag_std_s
    if std > _SURE_S:
        says = f"the rig turns too evenly (the guess is sure to {1e3 * std:.0f} ms)"
        return Finding("time offset", Severity.UNKNOWN, says)
    says = (
        f"the IMU's clock is {abs(1e3 * lag):.1f} ms {'ahead of' if lag > 0 else 'behind'} what"
        f" the calibration says (± {1e3 * std:.1f} ms)"
    )
    if abs(lag) <= max(sigma_s, _SIGMAS * std):
        return Finding("time offset", Severity.FINE, says)
    severity = Severity.WRONG if abs(lag) > max(_FOUND_S, _SIGMAS * std) else Severity.DOUBTFUL
    beyond = abs(lag) > SEARCH_S - STEP_S
    offset = f"{offset_s + lag:.4f}"
    remedy = (
        f"set timeshift_cam_imu to {offset}{' or more' if beyond else ''} in a Kalibr chain file"
        f" (--calibration), or recording.time_offset_s in the settings"
    )
    fix = {} if beyond else {"recording.time_offset_s": float(offset)}
    return Finding("time offset", severity, says, remedy, fix)


def _gyro_unit(found: GyroFit, locations: Locations) -> Finding:
    scale = float(np.linalg.norm(found.images_of_axes[0]))
    says = f"the images turn {scale:.3g} times as much as the gyroscope says"
    check, off, fix = "gyroscope unit", abs(scale - 1.0), {}
    if off <= _SCALE_OFF[0]:
        return Finding(check, Severity.FINE, says)
    if abs(scale * _DEGREE - 1.0) <= _SCALE_OFF[1]:
        remedy = f"the unit is °/s: multiply the rates in {locations.imu} by π/180"
        fix = {"recording.gyro_scale": 1.0 / _DEGREE}
    elif abs(scale / _DEGREE - 1.0) <= _SCALE_OFF[1]:
        remedy = (
            f"the rates were divided once too often: multiply those in {locations.imu} by 180/π"
        )
        fix = {"recording.gyro_scale": _DEGREE}
    elif off <= _SCALE_OFF[1]:
        remedy = "check the focal lengths, or the gyroscope's scale"
        return Finding(check, Severity.DOUBTFUL, says, remedy)
    else:
        remedy = f"convert the rates in {locations.imu} to rad/s, or check the focal lengths"
    return Finding(check, Severity.WRONG, says, remedy, fix)


def _mount(found: GyroFit, R_imu_cam0: FloatArray, locations: Locations) -> Finding:
    """The directions of the axes of turning, seen by the camera and put there by extrinsics."""
    expected, seen = found.axes @ R_imu_cam0, found.images_of_axes
    seen = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-300)
    cosine = float((expected * seen).sum(axis=1).min())
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    says = f"an axis of turning lies {angle:.1f}° from where the extrinsics put it"
    check = "camera on IMU"
    if angle <= _OFF_DEG[0]:
        return Finding(check, Severity.FINE, says)
    remedy = f"correct {locations.mount}: a rotation may be inverted, or an axis of the gyroscope"
    severity = Severity.DOUBTFUL if angle <= _OFF_DEG[1] else Severity.WRONG
    return Finding(check, severity, says, remedy)
