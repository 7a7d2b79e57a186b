"""The compiled normal equations of the motion between two stereo views of the same points.

`tests/geometry/test_stereo_motion_kernel.py` holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import invert_symmetric

LEAST_SQUARE = 1e-12
"""Squared distances are at least this, so that a weight can be divided by them."""


@part
def _project(q: FloatArray, rho: float, T: FloatArray, h: FloatArray, J: FloatArray) -> None:
    """Both views h (4,) of the point q / rho, q (3,) in the left camera, and their derivative
    J (4, 3) by q; T (4, 4): T_cam1_cam0."""
    h[0], h[1] = q[0] / q[2], q[1] / q[2]
    J[0, 0], J[0, 1], J[0, 2] = 1.0 / q[2], 0.0, -h[0] / q[2]
    J[1, 0], J[1, 1], J[1, 2] = 0.0, 1.0 / q[2], -h[1] / q[2]
    x = T[0, 0] * q[0] + T[0, 1] * q[1] + T[0, 2] * q[2] + rho * T[0, 3]
    y = T[1, 0] * q[0] + T[1, 1] * q[1] + T[1, 2] * q[2] + rho * T[1, 3]
    z = T[2, 0] * q[0] + T[2, 1] * q[1] + T[2, 2] * q[2] + rho * T[2, 3]
    h[2], h[3] = x / z, y / z
    for k in range(3):
        J[2, k] = (T[0, k] - h[2] * T[2, k]) / z
        J[3, k] = (T[1, k] - h[3] * T[2, k]) / z


@part
def _by_motion(J: FloatArray, rotated: FloatArray, rho: float, out: FloatArray) -> None:
    """Derivative out (4, 6) by a rotation on the left and a translation: q moves by φ x rotated and
    by rho τ. `J` (4, 3): derivative by q."""
    x, y, z = rotated[0], rotated[1], rotated[2]
    for i in range(4):
        out[i, 0] = J[i, 2] * y - J[i, 1] * z
        out[i, 1] = J[i, 0] * z - J[i, 2] * x
        out[i, 2] = J[i, 1] * x - J[i, 0] * y
        for k in range(3):
            out[i, 3 + k] = J[i, k] * rho


@part
def _weight(square: float, bound: float, huber: float) -> float:
    """Huber's weight of a squared distance, 0 from `bound` on."""
    if not square < bound:  # NaN as well
        return 0.0
    return min(1.0, huber / math.sqrt(max(square, LEAST_SQUARE)))


def motion_equations(
    T: FloatArray, p: FloatArray, z: FloatArray, W: FloatArray, T_c1_c0: FloatArray,
    bound: float, huber: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Information (6, 6) and gradient (6,) of a motion T (4, 4) that leads points p (N, 3) to where
    they are seen as z (N, 4), with inverse covariances W (N, 4, 4).

    Weights are Huber's, and 0 where the squared distance is `bound` or more.
    """
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    rotated, q, h, J, A = np.empty(3), np.empty(3), np.empty(4), np.empty((4, 3)), np.empty((4, 6))
    WA, Wr = np.empty((4, 6)), np.empty(4)
    for n in range(len(p)):
        for k in range(3):
            rotated[k] = T[k, 0] * p[n, 0] + T[k, 1] * p[n, 1] + T[k, 2] * p[n, 2]
            q[k] = rotated[k] + T[k, 3]
        _project(q, 1.0, T_c1_c0, h, J)
        square = 0.0
        for i in range(4):
            Wr[i] = 0.0
            for j in range(4):
                Wr[i] += W[n, i, j] * (z[n, j] - h[j])
            square += Wr[i] * (z[n, i] - h[i])
        weight = _weight(square, bound, huber)
        if weight == 0.0:
            continue
        _by_motion(J, rotated, 1.0, A)
        for i in range(4):
            for b in range(6):
                WA[i, b] = 0.0
                for j in range(4):
                    WA[i, b] += W[n, i, j] * A[j, b]
        for a in range(6):
            for i in range(4):
                gradient[a] += weight * A[i, a] * Wr[i]
                for b in range(6):
                    information[a, b] += weight * A[i, a] * WA[i, b]
    return information, gradient


@part
def _whitened(
    point: FloatArray, T: FloatArray, z: FloatArray, sigma: FloatArray, T_c1_c0: FloatArray,
    r: FloatArray, A: FloatArray, B: FloatArray,
) -> None:  # fmt: skip
    """Residual r (4,) of a point (x, y, 1/z) moved by T, and its derivatives A (4, 3) by the point
    and B (4, 6) by the motion, divided by `sigma` (4,). Homogeneous points are scaled by 1/z, so
    that far ones are no exception."""
    rotated, q, h, J = np.empty(3), np.empty(3), np.empty(4), np.empty((4, 3))
    rho = point[2]
    for k in range(3):
        rotated[k] = T[k, 0] * point[0] + T[k, 1] * point[1] + T[k, 2]
        q[k] = rotated[k] + rho * T[k, 3]
    _project(q, rho, T_c1_c0, h, J)
    _by_motion(J, rotated, rho, B)
    x, y, z1 = T_c1_c0[0, 3], T_c1_c0[1, 3], T_c1_c0[2, 3]
    depth = T_c1_c0[2, 0] * q[0] + T_c1_c0[2, 1] * q[1] + T_c1_c0[2, 2] * q[2] + rho * z1
    for i in range(4):
        for k in range(2):
            A[i, k] = J[i, 0] * T[0, k] + J[i, 1] * T[1, k] + J[i, 2] * T[2, k]
        A[i, 2] = J[i, 0] * T[0, 3] + J[i, 1] * T[1, 3] + J[i, 2] * T[2, 3]
    # the right view depends on 1/z also by the baseline
    A[2, 2] += (x - h[2] * z1) / depth
    A[3, 2] += (y - h[3] * z1) / depth
    for i in range(4):
        r[i] = (z[i] - h[i]) / sigma[i]
        for k in range(3):
            A[i, k] /= sigma[i]
        for k in range(6):
            B[i, k] /= sigma[i]


@part
def _eliminate(
    N: FloatArray, g: FloatArray, cross: FloatArray, shift: FloatArray, by_motion: FloatArray
) -> float:
    """Fill shift (3,) = N⁻¹ g and by_motion (3, 6) = N⁻¹ cross; gᵀ N⁻¹ g."""
    inverse, explained = np.empty((3, 3)), 0.0
    invert_symmetric(N, inverse)
    for a in range(3):
        shift[a] = inverse[a, 0] * g[0] + inverse[a, 1] * g[1] + inverse[a, 2] * g[2]
        explained += g[a] * shift[a]
        for c in range(6):
            by_motion[a, c] = (
                inverse[a, 0] * cross[0, c] + inverse[a, 1] * cross[1, c]
                + inverse[a, 2] * cross[2, c]
            )  # fmt: skip
    return explained


def motion_and_point_equations(
    T: FloatArray, point: FloatArray, before: FloatArray, now: FloatArray, sigma: FloatArray,
    T_c1_c0: FloatArray, bound: float, huber: float,
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray]:  # fmt: skip
    """Information (6, 6) and gradient (6,) of a motion T (4, 4) with the points eliminated (Schur
    complement), and which are inliers (N,).

    `point` (N, 3): (x, y, 1/z) in the earlier left view, seen as `before` and `now` (N, 4), with
    standard deviations `sigma` (4,). The points move by `shift` (N, 3) - `by_motion` (N, 3, 6) δ
    where the motion moves by δ.
    """
    n_points, eye = len(point), np.eye(4)
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    inlier = np.zeros(n_points, dtype=np.bool_)
    shift, by_motion = np.empty((n_points, 3)), np.empty((n_points, 3, 6))
    r0, A0, B = np.empty(4), np.empty((4, 3)), np.empty((4, 6))
    r1, A1, N = np.empty(4), np.empty((4, 3)), np.empty((3, 3))
    g, cross = np.empty(3), np.empty((3, 6))
    for n in range(n_points):
        _whitened(point[n], eye, before[n], sigma, T_c1_c0, r0, A0, B)
        _whitened(point[n], T, now[n], sigma, T_c1_c0, r1, A1, B)
        N[:], g[:], cross[:], square = 0.0, 0.0, 0.0, 0.0
        for i in range(4):
            square += r0[i] * r0[i] + r1[i] * r1[i]
            for a in range(3):
                g[a] += A0[i, a] * r0[i] + A1[i, a] * r1[i]
                for b in range(3):
                    N[a, b] += A0[i, a] * A0[i, b] + A1[i, a] * A1[i, b]
                for b in range(6):
                    cross[a, b] += A1[i, a] * B[i, b]
        square -= _eliminate(N, g, cross, shift[n], by_motion[n])
        weight = _weight(square, bound, huber)
        inlier[n] = weight > 0.0
        for a in range(6 if inlier[n] else 0):
            for i in range(4):
                gradient[a] += weight * B[i, a] * r1[i]
                for b in range(6):
                    information[a, b] += weight * B[i, a] * B[i, b]
            for c in range(3):
                gradient[a] -= weight * by_motion[n, c, a] * g[c]
                for b in range(6):
                    information[a, b] -= weight * by_motion[n, c, a] * cross[c, b]
    return information, gradient, inlier, shift, by_motion


_folder = code_folder(Path(__file__))
motion_equations_compiled = compiled(motion_equations, _folder)
motion_and_point_equations_compiled = compiled(motion_and_point_equations, _folder)
