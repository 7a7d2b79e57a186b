"""Compiled geometry of triangles: how flat one is, and the rigid motion of one to another.

Called by `rigid_kernel` only; tests/objects/test_rigid_kernel.py holds the plain NumPy twins.
"""

import math

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import part


@part
def smallest_height(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Smallest height of a triangle, metres."""
    first = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
    second = (c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2 + (c[2] - b[2]) ** 2
    third = (a[0] - c[0]) ** 2 + (a[1] - c[1]) ** 2 + (a[2] - c[2]) ** 2
    along = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1])
    along += (b[2] - a[2]) * (c[2] - b[2])
    area = math.sqrt(max(first * second - along**2, 0.0))
    return area / max(math.sqrt(max(first, second, third)), 1e-12)


@part
def register_triangle(
    p0: FloatArray, p1: FloatArray, p2: FloatArray, q0: FloatArray, q1: FloatArray, q2: FloatArray,
    T: FloatArray,
) -> None:  # fmt: skip
    """Least-squares rigid motion T (4, 4) of a triangle p to a triangle q.

    Both are flat: the normals meet, and the turn in the plane is Procrustes' in two dimensions.
    """
    P, x0, y0 = in_own_axes(p0, p1, p2)
    Q, u0, v0 = in_own_axes(q0, q1, q2)
    same, crossed = 0.0, 0.0
    for k in range(3):
        same += x0[k] * u0[k] + y0[k] * v0[k]
        crossed += x0[k] * v0[k] - y0[k] * u0[k]
    length = max(math.hypot(same, crossed), 1e-300)
    c, s = same / length, crossed / length
    for a in range(3):
        first, second = Q[a, 0] * c + Q[a, 1] * s, Q[a, 1] * c - Q[a, 0] * s
        T[a, 3] = (q0[a] + q1[a] + q2[a]) / 3.0
        for b in range(3):
            T[a, b] = first * P[b, 0] + second * P[b, 1] + Q[a, 2] * P[b, 2]
            T[a, 3] -= T[a, b] * (p0[b] + p1[b] + p2[b]) / 3.0


@part
def in_own_axes(
    a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[FloatArray, tuple[float, float, float], tuple[float, float, float]]:
    """Axes (3, 3) of a triangle, in columns, the last its normal; and its corners' coordinates (3,)
    along the first two, from the middle."""
    axes = np.empty((3, 3))
    length, along, height = 0.0, 0.0, 0.0
    for k in range(3):
        length += (b[k] - a[k]) ** 2
    length = max(math.sqrt(length), 1e-300)
    for k in range(3):
        axes[k, 0] = (b[k] - a[k]) / length
        along += (c[k] - a[k]) * axes[k, 0]
    for k in range(3):
        axes[k, 1] = c[k] - a[k] - along * axes[k, 0]
        height += axes[k, 1] ** 2
    height = max(math.sqrt(height), 1e-300)
    for k in range(3):
        axes[k, 1] /= height
    axes[0, 2] = axes[1, 0] * axes[2, 1] - axes[2, 0] * axes[1, 1]
    axes[1, 2] = axes[2, 0] * axes[0, 1] - axes[0, 0] * axes[2, 1]
    axes[2, 2] = axes[0, 0] * axes[1, 1] - axes[1, 0] * axes[0, 1]
    x, y = (length + along) / 3.0, height / 3.0
    return axes, (-x, length - x, along - x), (-y, -y, height - y)
