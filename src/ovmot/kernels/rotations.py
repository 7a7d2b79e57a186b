"""Compiled rotations: exponential, right Jacobian, product, and rounding taken out of a rotation.

Called by kernels only; arrays are filled in place. The plain NumPy twins are those of
`geometry.so3`.
"""

import math

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import part

_SMALL_ANGLE = 1e-3  # series below it


@part
def _by_hat(v: FloatArray, linear: float, square: float, out: FloatArray) -> None:
    """out (3, 3) = I + linear [v]x + square [v]x²."""
    x, y, z = v[0], v[1], v[2]
    for a in range(3):
        for b in range(3):
            out[a, b] = square * v[a] * v[b]
        out[a, a] += 1.0 - square * (x * x + y * y + z * z)
    out[0, 1] -= linear * z
    out[0, 2] += linear * y
    out[1, 0] += linear * z
    out[1, 2] -= linear * x
    out[2, 0] -= linear * y
    out[2, 1] += linear * x


@part
def rotation_exp(v: FloatArray, out: FloatArray) -> None:
    """Rotation matrix out (3, 3) of a rotation vector (3,), rad."""
    squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle = math.sqrt(squared)
    if angle < _SMALL_ANGLE:
        _by_hat(v, 1.0 - squared / 6.0, 0.5 - squared / 24.0, out)
    else:
        half_sine = math.sin(0.5 * angle) / angle
        _by_hat(v, math.sin(angle) / angle, 2.0 * half_sine * half_sine, out)


@part
def right_jacobian(v: FloatArray, out: FloatArray) -> None:
    """J_r (3, 3) with exp(v + dv) ~ exp(v) exp(J_r dv) for a rotation vector (3,), rad."""
    squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle = math.sqrt(squared)
    if angle < _SMALL_ANGLE:
        _by_hat(v, squared / 24.0 - 0.5, 1.0 / 6.0 - squared / 120.0, out)
    else:
        half_sine = math.sin(0.5 * angle) / angle
        cubic = (angle - math.sin(angle)) / (angle * squared)
        _by_hat(v, -2.0 * half_sine * half_sine, cubic, out)


@part
def multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = A B of (at least) 3x3 matrices; out is none of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@part
def orthonormalize(R: FloatArray) -> None:
    """Take rounding out of a rotation, the first 3 rows and columns of R, in place.

    Two steps of Newton's iteration R (3 I - Rᵀ R) / 2 to the nearest rotation: an error e becomes
    e⁴ (N. Higham, SIAM J. Sci. Stat. Comput. 7, 1986).
    """
    G, step = np.empty((3, 3)), np.empty((3, 3))
    for _ in range(2):
        for i in range(3):
            for j in range(3):
                inner = R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j]
                G[i, j] = (1.5 if i == j else 0.0) - 0.5 * inner
        multiply(R, G, step)
        for i in range(3):
            for j in range(3):
                R[i, j] = step[i, j]
