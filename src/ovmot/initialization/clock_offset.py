"""Camera-IMU time offset of a start in motion: the gyroscope against the turns of the pictures.

Cameras whose pictures are stamped on arrival are tens of milliseconds late, more than the filter
can make good by itself. Where the rig turns unevenly, the gyroscope's rates fit those of the
pictures at one offset only (F. Mair et al., "Spatio-temporal initialization for IMU to camera
registration", ROBIO 2011, do so by correlation).
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.stereo_path import StereoPath
from ovmot.physics import GYRO_BIAS_SIGMA_RPS, gate
from ovmot.vio.imu_buffer import ImuBuffer

SEARCH_S = 0.15
"""Offsets are sought so far to either side: drivers, cables and exposure add up to less."""
_STEP_S = 0.005
_FALSE_ALARM = 1e-4
"""Probability at which a calibrated offset that is right is given up."""


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """t_imu - t_cam and its standard deviation, s."""

    value_s: float
    sigma_s: float


def find_clock_offset(
    path: StereoPath, imu_ns: IntArray, imu: ImuBuffer, known: ClockOffset
) -> ClockOffset:
    """The offset by which the gyroscope turns as the path does, or the `known` one.

    `path`: K poses of the IMU by stereo; `imu_ns` (K,): their times by the known offset. That one
    stays unless another differs from it by more than a right one does with the probability
    `_FALSE_ALARM`, and where `imu` does not cover the search.
    """
    first, last = imu.first_ns, imu.last_ns
    reach_ns = round(1e9 * SEARCH_S)
    if first is None or last is None:
        return known
    if imu_ns[0] - reach_ns < first or imu_ns[-1] + reach_ns > last:
        return known
    turns, sigma = _turns(path)
    samples = imu.between(int(imu_ns[0]) - reach_ns, int(imu_ns[-1]) + reach_ns)
    at = 1e-9 * (samples.timestamp_ns - imu_ns[0])
    angle = integrated_rates(at, samples.gyro)
    edges = 1e-9 * (imu_ns - imu_ns[0])
    lags = np.arange(-SEARCH_S, SEARCH_S + 0.5 * _STEP_S, _STEP_S)
    cost = np.array([_chi_squared(turns, sigma, at, angle, edges + lag) for lag in lags])
    best = int(np.argmin(cost))
    if best in (0, len(lags) - 1):
        return known
    before, least, after = cost[best - 1 : best + 2]
    curvature = (before - 2.0 * least + after) / _STEP_S**2
    if not curvature > 0.0:
        return known
    # the residual is more than stereo's own noise where the samples are few: it scales the rest
    scale = max(least / max(3 * len(turns) - 4, 1), 1.0)
    lag = float(lags[best] + 0.5 * _STEP_S * (before - after) / (before - 2.0 * least + after))
    sigma_s = float(np.sqrt(2.0 * scale / curvature))
    refused = lag**2 > gate(1, 1.0 - _FALSE_ALARM) * (sigma_s**2 + known.sigma_s**2)
    return ClockOffset(known.value_s + lag, sigma_s) if refused else known


def _turns(path: StereoPath) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors (K - 1, 3) between the poses, in the IMU's axes, and their standard
    deviations (K - 1,)."""
    R = path.T_first_imu[:, :3, :3]
    turns = so3.log(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    return turns, np.sqrt(np.diff(path.rotation_sigma**2))


def integrated_rates(at: FloatArray, rates: FloatArray) -> FloatArray:
    """Integral (N, 3) of rates (N, 3) from the first time on, by trapezoids."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(at)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _chi_squared(
    turns: FloatArray, sigma: FloatArray, at: FloatArray, angle: FloatArray, edges: FloatArray
) -> float:
    """Of the turns against the gyroscope's between the times `edges` (K,), with the bias that fits
    best under its prior."""
    span = np.diff(edges)[:, None]
    gyro = np.stack([np.diff(np.interp(edges, at, axis)) for axis in angle.T], axis=1)
    weight = 1.0 / sigma[:, None] ** 2
    rest = turns - gyro
    bias = (weight * span * rest).sum(0) / ((weight * span**2).sum() + GYRO_BIAS_SIGMA_RPS**-2)
    return float(
        (weight * (rest - span * bias) ** 2).sum() + (bias**2).sum() / GYRO_BIAS_SIGMA_RPS**2
    )
