"""Compiled camera models: what a lens does to a point of the ideal image plane, and pixels.

Called by kernels only. The plain NumPy twins are the models of `cameras.models`: each of them has a
code here, its place in `LENSES`.
"""

import math

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.models.radtan_kernel import distort as distort_radtan
from ovmot.cameras.models.radtan_kernel import distort_by as distort_radtan_by
from ovmot.cameras.models.radtan_kernel import distort_jacobian as distort_radtan_jacobian
from ovmot.cameras.models.radtan_kernel import jacobian_by as radtan_jacobian_by
from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import inlined_part, part

LENSES = ("none", "radtan", "equidistant", "omni", "eucm", "ds")
_RADTAN, _EQUIDISTANT, _OMNI, _EUCM, _DS = 1, 2, 3, 4, 5

Four = tuple[float, float, float, float]


@inlined_part
def _denominator(lens: int, d: FloatArray, square: float) -> tuple[float, float]:
    """D of a model with m = (x, y) / D, and its derivative by `square` = x² + y².

    The formulas are those of the models' own files.
    """
    if lens == _OMNI:
        d1 = math.sqrt(square + 1.0)
        return 1.0 + d[0] * d1, 0.5 * d[0] / d1
    if lens == _EUCM:
        alpha, beta = d[0], d[1]
        rho = math.sqrt(beta * square + 1.0)
        return alpha * rho + 1.0 - alpha, 0.5 * alpha * beta / rho
    xi, alpha = d[0], d[1]
    d1 = math.sqrt(square + 1.0)
    e = xi * d1 + 1.0
    d2 = math.sqrt(square + e * e)
    w1 = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
    slope = 0.5 * xi / d1
    D = alpha * d2 + (1.0 - alpha) * e if e > -w1 * d2 else math.nan
    return D, alpha * (0.5 + e * slope) / d2 + (1.0 - alpha) * slope


@part
def distort(lens: int, d: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Distorted normalized coordinates of undistorted ones, with coefficients d (5,)."""
    if lens == _RADTAN:
        return distort_radtan(d, x, y)
    if lens == _EQUIDISTANT:
        r = math.sqrt(x * x + y * y)
        if r < 1e-8:
            return x, y
        theta = math.atan(r)
        t2 = theta * theta
        scale = theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3])))) / r
        return x * scale, y * scale
    if lens >= _OMNI:
        D, _ = _denominator(lens, d, x * x + y * y)
        if lens == _OMNI:
            return distort_radtan_by(d[1], d[2], d[3], d[4], 0.0, x / D, y / D)
        return x / D, y / D
    return x, y


@part
def distort_jacobian(lens: int, d: FloatArray, x: float, y: float) -> Four:
    """Derivative of `distort` by (x, y), row by row."""
    if lens == _RADTAN:
        return distort_radtan_jacobian(d, x, y)
    if lens == _EQUIDISTANT:
        r = math.sqrt(x * x + y * y)
        if r < 1e-8:
            return 1.0, 0.0, 0.0, 1.0
        theta = math.atan(r)
        t2 = theta * theta
        scale = theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3])))) / r
        slope = 1.0 + t2 * (3.0 * d[0] + t2 * (5.0 * d[1] + t2 * (7.0 * d[2] + t2 * 9.0 * d[3])))
        along = (slope / (1.0 + r * r) - scale) / (r * r)
        return scale + along * x * x, along * x * y, along * x * y, scale + along * y * y
    if lens >= _OMNI:
        D, slope = _denominator(lens, d, x * x + y * y)
        along = -2.0 * slope / (D * D)
        a, b, c = 1.0 / D + along * x * x, along * x * y, 1.0 / D + along * y * y
        if lens == _OMNI:
            e, f, g, h = radtan_jacobian_by(d[1], d[2], d[3], d[4], 0.0, x / D, y / D)
            return e * a + f * b, e * b + f * c, g * a + h * b, g * b + h * c
        return a, b, b, c
    return 1.0, 0.0, 0.0, 1.0


@part
def to_pixel(lens: int, camera: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Pixel of undistorted normalized coordinates; `camera` (12,): see `Camera.packed`."""
    x, y = distort(lens, camera[5:10], x, y)
    return camera[0] * x + camera[4] * y + camera[2], camera[1] * y + camera[3]


@part
def pixel_jacobian(lens: int, camera: FloatArray, x: float, y: float) -> Four:
    """Derivative of `to_pixel` by (x, y), row by row."""
    a, b, c, d = distort_jacobian(lens, camera[5:10], x, y)
    fx, fy, skew = camera[0], camera[1], camera[4]
    return fx * a + skew * c, fx * b + skew * d, fy * c, fy * d


def packed_camera(camera: Camera) -> tuple[int, FloatArray]:
    """Code of its lens, and a camera (12,): see `Camera.packed`.

    Raises `ValueError` for a camera model without compiled code.
    """
    return LENSES.index(camera.model.name), camera.packed


def packed_cameras(rig: StereoRig) -> tuple[IntArray, FloatArray]:
    """Codes of the lenses (2,), and both cameras (2, 12): see `packed_camera`."""
    lens = [LENSES.index(camera.model.name) for camera in rig.cameras]
    return np.array(lens, dtype=np.int64), rig.packed
