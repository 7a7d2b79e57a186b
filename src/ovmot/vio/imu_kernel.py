"""Compiled work on IMU samples: those of an interval, and the Runge-Kutta increments of its pairs.

tests/vio/test_imu_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.rotations import rotation_exp

_SMALL_ANGLE = 1e-3  # series below it


@part
def _merged(stamps: IntArray, first: int, end: int, wanted: IntArray, out: IntArray) -> int:
    """The `wanted` times and the stamps between the first and last of them, each once; how many."""
    n, k, last = 0, first, len(wanted) - 1
    for w in range(len(wanted)):
        while k < end and stamps[k] < wanted[w]:
            if stamps[k] > wanted[0]:
                out[n] = stamps[k]
                n += 1
            k += 1
        if w == 0 or wanted[w] != wanted[w - 1]:
            out[n] = wanted[w]
            n += 1
        if k < end and stamps[k] == wanted[w] and w < last:
            k += 1
    return n


def samples_between(
    stamps: IntArray, rates: FloatArray, first: int, end: int, wanted: IntArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stamps (n,), gyro (n, 3) and accel (n, 3) at the `wanted` times and at the samples between.

    `stamps` (m,), ns, and `rates` (m, 6): samples in time order, of which those from `first` to
    `end` count; `wanted` (k,), ns, rising: its first and last are the interval's ends. The last
    sample is held. Linear as `np.interp`, in seconds since the start: epoch nanoseconds do not fit
    into a double.
    """
    at = np.empty(end - first + len(wanted), dtype=np.int64)
    n, k, start = _merged(stamps, first, end, wanted, at), first, wanted[0]
    gyro, accel = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        while k < end - 1 and stamps[k + 1] <= at[i]:
            k += 1
        x0, x = (stamps[k] - start) * 1e-9, (at[i] - start) * 1e-9
        for c in range(3):
            gyro[i, c], accel[i, c] = rates[k, c], rates[k, 3 + c]
            if k < end - 1:
                span = (stamps[k + 1] - start) * 1e-9 - x0
                gyro[i, c] += (rates[k + 1, c] - rates[k, c]) / span * (x - x0)
                accel[i, c] += (rates[k + 1, 3 + c] - rates[k, 3 + c]) / span * (x - x0)
    return at[:n].copy(), gyro, accel


@part
def _cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Cross product out (3,) = a x b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@part
def _turn_rate(phi: FloatArray, w: FloatArray, out: FloatArray) -> None:
    """Rate out (3,) of a rotation vector phi (3,): J_r⁻¹(φ) w = w + ½ φ x w + d φ x (φ x w)."""
    squared = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    angle = math.sqrt(squared)
    if angle < _SMALL_ANGLE:
        d = 1.0 / 12.0 + squared / 720.0
    else:
        d = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / squared
    once, twice = np.empty(3), np.empty(3)
    _cross(phi, w, once)
    _cross(phi, once, twice)
    for i in range(3):
        out[i] = w[i] + 0.5 * once[i] + d * twice[i]


def rk4_increments(
    gyro: FloatArray, accel: FloatArray, dt: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotations (n, 3, 3), velocities (n, 3) and positions (n, 3): see `integrate_rk4`.

    `gyro`, `accel` (n + 1, 3): rates, rad/s, and forces, m/s², without bias; `dt` (n,), s.
    """
    n = len(dt)
    turn, velocity, position = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    phi, wm, R_mid = np.empty(3), np.empty(3), np.empty((3, 3))
    k2, k3, k4 = np.empty(3), np.empty(3), np.empty(3)
    for p in range(n):
        h, w0, w1, a0, a1 = dt[p], gyro[p], gyro[p + 1], accel[p], accel[p + 1]
        for i in range(3):
            wm[i] = 0.5 * (w0[i] + w1[i])
            phi[i] = 0.5 * h * w0[i]
        _turn_rate(phi, wm, k2)
        for i in range(3):
            phi[i] = 0.5 * h * k2[i]
        rotation_exp(phi, R_mid)
        _turn_rate(phi, wm, k3)
        for i in range(3):
            phi[i] = h * k3[i]
        _turn_rate(phi, w1, k4)
        for i in range(3):
            phi[i] = h / 6.0 * (w0[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        rotation_exp(phi, turn[p])
        for i in range(3):
            middle, end = 0.0, 0.0
            for k in range(3):
                middle += R_mid[i, k] * (0.5 * (a0[k] + a1[k]))
                end += turn[p, i, k] * a1[k]
            velocity[p, i] = h / 6.0 * (a0[i] + 4.0 * middle + end)
            position[p, i] = h * h / 6.0 * (a0[i] + 2.0 * middle)
    return turn, velocity, position


_FOLDER = code_folder(Path(__file__))
samples_between_compiled = compiled(samples_between, _FOLDER)
rk4_increments_compiled = compiled(rk4_increments, _FOLDER)
