"""Compiled comparison of all tracks with all measurements of a frame.

tests/objects/test_association_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import factor


class Bodies(NamedTuple):
    """K bodies: position and velocity `x` (K, 6) in world with covariance (K, 6, 6), and size
    (K, 3). `seconds` (K,): of a track, since its last measurement; of a measurement, its span."""

    x: FloatArray
    covariance: FloatArray
    size: FloatArray
    seconds: FloatArray


class SeenParts(NamedTuple):
    """How far what is seen of a body may lie from its centre: a share of its size, at least some
    metres, one standard deviation. What is faster than `drives_mps` may be longer than was seen,
    as a car is."""

    centre_share: float
    least_sigma_m: float
    drives_mps: float
    car_length_m: float


_LEVEL = (0, 1, 3, 4)
"""Of position and velocity, what is level."""


@part
def innovation(
    tracks: Bodies, i: int, measured: Bodies, j: int, parts: SeenParts, r: FloatArray, S: FloatArray
) -> None:
    """Fill position and velocity of a measurement less those of a track, r (6,), and their
    covariance S (6, 6)."""
    length, size = max(tracks.size[i, 0], measured.size[j, 0]), 0.0
    for a in range(3):
        size = max(size, tracks.size[i, a], measured.size[j, a])
    centre = max(parts.centre_share * size, parts.least_sigma_m)
    # measurements that overlap in time are correlated
    count = max(measured.seconds[j] / max(tracks.seconds[i], 1e-3), 1.0)
    for a in range(6):
        r[a] = measured.x[j, a] - tracks.x[i, a]
        for b in range(6):
            R = measured.covariance[j, a, b] + (centre**2 if a == b and a < 3 else 0.0)
            S[a, b] = tracks.covariance[i, a, b] + count * R
    v = tracks.x[i, 3:]
    speed = math.hypot(v[0], v[1])
    if speed > parts.drives_mps:  # its other end may come into view
        hidden = max(parts.car_length_m - length, 0.0) * parts.centre_share / speed
        for a in range(3):
            for b in range(3):
                S[a, b] += hidden**2 * v[a] * v[b]


@part
def distance_and_log_det(r: FloatArray, S: FloatArray) -> tuple[float, float]:
    """Squared Mahalanobis distance of r (k,) with covariance S (k, k), positive definite, and the
    logarithm of its determinant; S becomes its factor, r is whitened."""
    factor(S)
    squared, log_det = 0.0, 0.0
    for a in range(len(r)):
        for b in range(a):
            r[a] -= S[a, b] * r[b]
        r[a] /= S[a, a]
        squared += r[a] ** 2
        log_det += 2.0 * math.log(S[a, a])
    return squared, log_det


def compare(tracks: Bodies, measured: Bodies, parts: SeenParts) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (T, M) of measurements from predicted tracks, over position and
    velocity, and the logarithm (T, M) of their densities over what is level of both."""
    T, M = len(tracks.x), len(measured.x)
    distance, log_density = np.empty((T, M)), np.empty((T, M))
    r, S, r_level, S_level = np.empty(6), np.empty((6, 6)), np.empty(4), np.empty((4, 4))
    for i in range(T):
        for j in range(M):
            innovation(tracks, i, measured, j, parts, r, S)
            for a in range(4):
                r_level[a] = r[_LEVEL[a]]
                for b in range(4):
                    S_level[a, b] = S[_LEVEL[a], _LEVEL[b]]
            squared, log_det = distance_and_log_det(r_level, S_level)
            log_density[i, j] = -0.5 * (squared + log_det) - 2.0 * math.log(2.0 * math.pi)
            distance[i, j], _ = distance_and_log_det(r, S)
    return distance, log_density


_FOLDER = code_folder(Path(__file__))
compare_compiled = compiled(compare, _FOLDER)
