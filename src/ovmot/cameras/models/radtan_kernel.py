"""The compiled form of `radtan`: points one by one, and the way back for many of them."""

from pathlib import Path

import numpy as np

from ovmot.cameras.models.model import NEWTON_STEPS, TOLERANCE
from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part

Four = tuple[float, float, float, float]


@inlined_part
def distort_by(
    k1: float, k2: float, p1: float, p2: float, k3: float, x: float, y: float
) -> tuple[float, float]:
    """`distort` with its coefficients one by one."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


@inlined_part
def jacobian_by(k1: float, k2: float, p1: float, p2: float, k3: float, x: float, y: float) -> Four:
    """`distort_jacobian` with its coefficients one by one."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))  # d(radial)/dx = slope * x
    mixed = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    return (
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        mixed,
        mixed,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@part
def distort(d: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Distorted normalized coordinates of undistorted ones, d (5,): k1, k2, p1, p2, k3."""
    return distort_by(d[0], d[1], d[2], d[3], d[4], x, y)


@part
def distort_jacobian(d: FloatArray, x: float, y: float) -> Four:
    """Derivative of `distort` by (x, y), row by row."""
    return jacobian_by(d[0], d[1], d[2], d[3], d[4], x, y)


def undistort(distorted: FloatArray, d: FloatArray, fold_squared: float) -> FloatArray:
    """Undistorted coordinates (N, 2) of distorted ones (N, 2) by Newton's method; NaN where there
    are none, or not within the radius, `fold_squared` its square, at which the model folds back."""
    out = np.full(distorted.shape, np.nan)
    for n in range(len(distorted)):
        target_x, target_y = distorted[n]
        x, y, found = target_x, target_y, False
        for step in range(NEWTON_STEPS + 1):
            at_x, at_y = distort(d, x, y)
            miss_x, miss_y = at_x - target_x, at_y - target_y
            miss = max(abs(miss_x), abs(miss_y))
            found = miss < 1e-8
            if miss <= TOLERANCE or step == NEWTON_STEPS:
                break
            a, b, c, e = distort_jacobian(d, x, y)
            det = a * e - b * c
            if not abs(det) >= 1e-9:  # NaN as well
                found = False
                break
            x -= (e * miss_x - b * miss_y) / det
            y -= (a * miss_y - c * miss_x) / det
        if found and x * x + y * y < fold_squared:
            out[n, 0], out[n, 1] = x, y
    return out


undistort_compiled = compiled(undistort, code_folder(Path(__file__)))
