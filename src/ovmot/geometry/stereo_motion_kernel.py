"""The compiled sums of `stereo_motion`: over proposals, and over points in each Gauss-Newton step.

tests/geometry/test_stereo_motion_kernel.py holds them against plain NumPy.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.kernels.small_matrices import invert_symmetric
from ovmot.kernels.stereo import project


@inlined_part
def _squared_error(r: FloatArray, W: FloatArray) -> float:
    """rᵀ W r of a residual (4,) and a symmetric W (4, 4)."""
    total = 0.0
    for a in range(4):
        total += r[a] * r[a] * W[a, a]
        for b in range(a):
            total += 2.0 * r[a] * r[b] * W[a, b]
    return total


def count_inliers(
    proposals: FloatArray,
    rotated: FloatArray,
    z: FloatArray,
    W: FloatArray,
    T_c1_c0: FloatArray,
    bound: float,
) -> IntArray:
    """How many points (H,) each translation (H, 3) explains.

    `rotated` (N, 3): points turned into the view now, m; `z` (N, 4): where they are seen; `W`
    (N, 4, 4): inverse covariances of that; `bound`: greatest squared Mahalanobis distance.
    """
    count = np.zeros(len(proposals), dtype=np.int64)
    q, h, J = np.empty(3), np.empty(4), np.empty((4, 3))
    for k in range(len(proposals)):
        for n in range(len(rotated)):
            for a in range(3):
                q[a] = rotated[n, a] + proposals[k, a]
            project(q, T_c1_c0, h, J)
            for a in range(4):
                h[a] = z[n, a] - h[a]
            if _squared_error(h, W[n]) < bound:
                count[k] += 1
    return count


def motion_system(
    T: FloatArray,
    p: FloatArray,
    z: FloatArray,
    W: FloatArray,
    T_c1_c0: FloatArray,
    bound: float,
    huber: float,
) -> tuple[FloatArray, FloatArray]:
    """Information (6, 6) and gradient (6,) of the motion T (4, 4) by points p (N, 3), m, held fixed
    and seen now as `z` (N, 4), with Huber weights; those beyond the `bound` are left out."""
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    rotated, q, r = np.empty(3), np.empty(3), np.empty(4)
    by_point, J, WJ = np.empty((4, 3)), np.empty((4, 6)), np.empty((4, 6))
    for n in range(len(p)):
        for a in range(3):
            rotated[a] = T[a, 0] * p[n, 0] + T[a, 1] * p[n, 1] + T[a, 2] * p[n, 2]
            q[a] = rotated[a] + T[a, 3]
        project(q, T_c1_c0, r, by_point)
        for a in range(4):
            r[a] = z[n, a] - r[a]
        squared = max(_squared_error(r, W[n]), 1e-12)
        if not squared < bound:
            continue
        weight = min(1.0, huber / math.sqrt(squared))
        for a in range(4):
            d0, d1, d2 = by_point[a, 0], by_point[a, 1], by_point[a, 2]
            J[a, 0], J[a, 3] = d2 * rotated[1] - d1 * rotated[2], d0
            J[a, 1], J[a, 4] = d0 * rotated[2] - d2 * rotated[0], d1
            J[a, 2], J[a, 5] = d1 * rotated[0] - d0 * rotated[1], d2
        for a in range(4):
            for j in range(6):
                WJ[a, j] = 0.0
                for b in range(4):
                    WJ[a, j] += weight * W[n, a, b] * J[b, j]
        for a in range(4):
            for i in range(6):
                gradient[i] += WJ[a, i] * r[a]
                for j in range(6):
                    information[i, j] += J[a, i] * WJ[a, j]
    return information, gradient


@part
def _rows(
    point: FloatArray,
    T: FloatArray,
    z: FloatArray,
    sigma: FloatArray,
    T_c1_c0: FloatArray,
    r: FloatArray,
    by_point: FloatArray,
    by_motion: FloatArray,
) -> None:
    """Whitened residual r (4,) of a point (x, y, 1/z) moved by T and seen as z (4,), and its
    derivatives by the point (4, 3) and by the motion (4, 6).

    The point is scaled by 1/z, so that a far one is no exception.
    """
    x, y, rho = point[0], point[1], point[2]
    t0, t1, t2 = T[0, 3], T[1, 3], T[2, 3]
    p0, p1, p2 = (  # turned
        T[0, 0] * x + T[0, 1] * y + T[0, 2],
        T[1, 0] * x + T[1, 1] * y + T[1, 2],
        T[2, 0] * x + T[2, 1] * y + T[2, 2],
    )
    q0, q1, q2 = p0 + rho * t0, p1 + rho * t1, p2 + rho * t2
    S = T_c1_c0
    s2 = S[2, 0] * q0 + S[2, 1] * q1 + S[2, 2] * q2 + rho * S[2, 3]
    for a in range(4):
        k = a % 2
        if a < 2:
            h = (q0 if k == 0 else q1) / q2
            scale = 1.0 / (q2 * sigma[a])
            d0, d1, d2 = (scale if k == 0 else 0.0), (scale if k == 1 else 0.0), -h * scale
            along = 0.0
        else:
            h = (S[k, 0] * q0 + S[k, 1] * q1 + S[k, 2] * q2 + rho * S[k, 3]) / s2
            scale = 1.0 / (s2 * sigma[a])
            d0 = (S[k, 0] - h * S[2, 0]) * scale
            d1 = (S[k, 1] - h * S[2, 1]) * scale
            d2 = (S[k, 2] - h * S[2, 2]) * scale
            along = (S[k, 3] - h * S[2, 3]) * scale
        r[a] = (z[a] - h) / sigma[a]
        by_point[a, 0] = d0 * T[0, 0] + d1 * T[1, 0] + d2 * T[2, 0]
        by_point[a, 1] = d0 * T[0, 1] + d1 * T[1, 1] + d2 * T[2, 1]
        by_point[a, 2] = d0 * t0 + d1 * t1 + d2 * t2 + along
        by_motion[a, 0], by_motion[a, 3] = d2 * p1 - d1 * p2, d0 * rho
        by_motion[a, 1], by_motion[a, 4] = d0 * p2 - d2 * p0, d1 * rho
        by_motion[a, 2], by_motion[a, 5] = d1 * p0 - d0 * p1, d2 * rho


@part
def _point_system(
    r: FloatArray, A: FloatArray, J: FloatArray, N: FloatArray, g: FloatArray, cross: FloatArray
) -> float:
    """Of a point's 8 rows: AᵀA (3, 3), Aᵀr (3,), Aᵀ(0, J) (3, 6); returns the squared residual."""
    total = 0.0
    for i in range(3):
        g[i] = 0.0
        for j in range(3):
            N[i, j] = 0.0
        for j in range(6):
            cross[i, j] = 0.0
    for a in range(8):
        total += r[a] * r[a]
        for i in range(3):
            g[i] += A[a, i] * r[a]
            for j in range(i, 3):
                N[i, j] += A[a, i] * A[a, j]
    for a in range(4):
        for i in range(3):
            for j in range(6):
                cross[i, j] += A[4 + a, i] * J[a, j]
    return total


def motion_and_points_system(
    T: FloatArray,
    points: FloatArray,
    before: FloatArray,
    now: FloatArray,
    sigma: FloatArray,
    T_c1_c0: FloatArray,
    bound: float,
    huber: float,
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray]:
    """The motion's information (6, 6) and gradient (6,), the points eliminated; inliers (N,); and
    the points' step c - B δ for that of the motion δ: c (N, 3), B (N, 3, 6).

    `points` (N, 3): (x, y, 1/z) in the earlier left view; `before`, `now` (N, 4): normalized
    coordinates of standard deviations `sigma` (4,). Huber weights from `huber` sigmas on; points
    whose squared error, at their own best place, is beyond the `bound` are left out.
    """
    n_points = len(points)
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    inlier = np.zeros(n_points, dtype=np.bool_)
    c, B = np.zeros((n_points, 3)), np.zeros((n_points, 3, 6))
    r, A, J, unused = np.empty(8), np.empty((8, 3)), np.empty((4, 6)), np.empty((4, 6))
    N, inverse, g, cross = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 6))
    at_rest = np.eye(4)
    for n in range(n_points):
        _rows(points[n], at_rest, before[n], sigma, T_c1_c0, r[:4], A[:4], unused)
        _rows(points[n], T, now[n], sigma, T_c1_c0, r[4:], A[4:], J)
        squared = _point_system(r, A, J, N, g, cross)
        invert_symmetric(N, inverse)
        for i in range(3):
            for k in range(3):
                c[n, i] += inverse[i, k] * g[k]
                for j in range(6):
                    B[n, i, j] += inverse[i, k] * cross[k, j]
            squared -= g[i] * c[n, i]
        squared = max(squared, 1e-12)
        inlier[n] = squared < bound
        if not inlier[n]:
            continue
        weight = min(1.0, huber / math.sqrt(squared))
        for i in range(6):
            for a in range(4):
                gradient[i] += weight * J[a, i] * r[4 + a]
                for j in range(6):
                    information[i, j] += weight * J[a, i] * J[a, j]
            for k in range(3):
                gradient[i] -= weight * cross[k, i] * c[n, k]
                for j in range(6):
                    information[i, j] -= weight * cross[k, i] * B[n, k, j]
    return information, gradient, inlier, c, B


_FOLDER = code_folder(Path(__file__))
count_inliers_compiled = compiled(count_inliers, _FOLDER)
motion_system_compiled = compiled(motion_system, _FOLDER)
motion_and_points_system_compiled = compiled(motion_and_points_system, _FOLDER)
