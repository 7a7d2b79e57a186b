"""Compiled stereo geometry of single points: triangulation, projection, covariance.

Called by kernels only; arrays are filled in place. Image points are normalized (undistorted)
coordinates, points are in the left camera in metres, T (4, 4) is `T_cam1_cam0` unless it is named
otherwise. The plain NumPy twins are those of `geometry.triangulation`.
"""

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import part


@part
def transform(T: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """out (3,) = T p."""
    for a in range(3):
        out[a] = T[a, 0] * p[0] + T[a, 1] * p[1] + T[a, 2] * p[2] + T[a, 3]


@part
def triangulate(uv: FloatArray, T: FloatArray, p: FloatArray) -> bool:
    """Point p (3,) of a stereo pair uv (4,), as `triangulate_stereo`; False where there is none."""
    x = T[0, 0] * uv[0] + T[0, 1] * uv[1] + T[0, 2]
    y = T[1, 0] * uv[0] + T[1, 1] * uv[1] + T[1, 2]
    z = T[2, 0] * uv[0] + T[2, 1] * uv[1] + T[2, 2]
    a0, a1 = x - uv[2] * z, y - uv[3] * z
    b0, b1 = uv[2] * T[2, 3] - T[0, 3], uv[3] * T[2, 3] - T[1, 3]
    depth = (a0 * b0 + a1 * b1) / (a0 * a0 + a1 * a1)
    p[0], p[1], p[2] = uv[0] * depth, uv[1] * depth, depth
    return bool(0.0 < depth < 1e4 and depth * z + T[2, 3] > 0.0)


@part
def project(p: FloatArray, T: FloatArray, h: FloatArray, J: FloatArray) -> None:
    """Both views h (4,) of a point and their derivative J (4, 3), as `project_stereo`."""
    q = np.empty(3)
    transform(T, p, q)
    for i in range(2):
        h[i], h[2 + i] = p[i] / p[2], q[i] / q[2]
        for k in range(3):
            J[i, k] = 1.0 / p[2] if i == k else 0.0
            J[2 + i, k] = (T[i, k] - h[2 + i] * T[2, k]) / q[2]
        J[i, 2] = -h[i] / p[2]


@part
def secant(p_from: FloatArray, p_to: FloatArray, T: FloatArray, D: FloatArray) -> None:
    """D (4, 3) with h(p_to) - h(p_from) = D (p_to - p_from) for both views h, exactly.

    In one view, with x = X/Z: x' - x = ((X' - X) - x (Z' - Z)) / Z'.
    """
    start, end = np.empty(3), np.empty(3)
    transform(T, p_from, start)
    transform(T, p_to, end)
    for i in range(2):
        for k in range(3):
            D[i, k] = 1.0 / p_to[2] if i == k else 0.0
            D[2 + i, k] = (T[i, k] - start[i] / start[2] * T[2, k]) / end[2]
        D[i, 2] = -p_from[i] / p_from[2] / p_to[2]


@part
def stereo_covariance(p: FloatArray, T: FloatArray, sigma: FloatArray, C: FloatArray) -> None:
    """Covariance C (3, 3) of a triangulated point, m², as `geometry.triangulation` has it.

    `sigma` (4,): standard deviations of the normalized coordinates of both views.
    """
    ray, G = (p[0] / p[2], p[1] / p[2], 1.0), np.empty((3, 4))
    h, J = np.empty(4), np.empty((4, 3))
    project(p, T, h, J)
    along0 = J[2, 0] * ray[0] + J[2, 1] * ray[1] + J[2, 2]
    along1 = J[3, 0] * ray[0] + J[3, 1] * ray[1] + J[3, 2]
    square = along0 * along0 + along1 * along1
    right = (along0 / square, along1 / square)
    for a in range(3):
        for k in range(2):
            left = right[0] * J[2, k] + right[1] * J[3, k]
            G[a, k] = p[2] * ((1.0 if a == k else 0.0) - ray[a] * left) * sigma[k]
            G[a, 2 + k] = ray[a] * right[k] * sigma[2 + k]
    for a in range(3):
        for b in range(3):
            C[a, b] = G[a, 0] * G[b, 0] + G[a, 1] * G[b, 1] + G[a, 2] * G[b, 2] + G[a, 3] * G[b, 3]
