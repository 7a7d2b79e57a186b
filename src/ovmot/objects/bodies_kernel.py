"""Compiled small questions about bodies: distances, the ground below, noise and places of points.

tests/objects/test_bodies_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import cross, squared_mahalanobis
from ovmot.kernels.sorting import median

_SMALL_ANGLE, _SERIES_ANGLE = 1e-5, 1e-3  # series below them
_NEAR_PI = math.pi - 1e-4


def velocity_distance(error: FloatArray, covariance: FloatArray, spread: float) -> float:
    """Squared Mahalanobis distance of an error (3,), `spread` added to each axis' deviation."""
    C = covariance.copy()
    for a in range(3):
        C[a, a] += spread * spread
    return float(squared_mahalanobis(error, C))


def least_distance(p: FloatArray, q: FloatArray) -> float:
    """The least distance between points (N, 3) and (M, 3)."""
    least = np.inf
    for n in range(len(p)):
        for m in range(len(q)):
            x, y, z = p[n, 0] - q[m, 0], p[n, 1] - q[m, 1], p[n, 2] - q[m, 2]
            least = min(least, x * x + y * y + z * z)
    return math.sqrt(least)


@part
def _ranked(values: FloatArray, n: int, rank: int) -> float:
    """The value of this rank, from 0, among the first n, which are sorted then."""
    median(values, n)
    return float(values[rank])


def height_above_ground(
    p_world: FloatArray, static: FloatArray, radius: float, min_points: int
) -> float:
    """How far the highest tenth of points (N, 3) begins above the ground; infinite if not known.

    The ground is the height below which a tenth of the static points (M, 3) within `radius` metres
    of the points' mean are, if there are `min_points` of them.
    """
    x, y, n = 0.0, 0.0, 0
    own, near = np.empty(len(p_world)), np.empty(len(static))
    for k in range(len(p_world)):
        x += p_world[k, 0] / len(p_world)
        y += p_world[k, 1] / len(p_world)
        own[k] = p_world[k, 2]
    for k in range(len(static)):
        if (static[k, 0] - x) ** 2 + (static[k, 1] - y) ** 2 < radius**2:
            near[n] = static[k, 2]
            n += 1
    if n < min_points:
        return math.inf
    top = _ranked(own, len(own), len(own) - 1 - len(own) // 10)
    return top - _ranked(near, n, n // 10)


def view_weights(
    seen: FloatArray, body: IntArray, track_length: FloatArray, focal: FloatArray, sigma_px: float,
    drift_per_frame_px: float, drift_per_flow: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:  # fmt: skip
    """`by_difference` and `by_sum` (V, M) of `weighted_views`, and which views (V, M) exist.

    `seen` (V, M, 4): normalized coordinates, the last view that of now; `track_length` (V, B).
    """
    n_views, n_points = seen.shape[:2]
    by_difference, by_sum = np.zeros((n_views, n_points)), np.zeros((n_views, n_points))
    valid, now = np.zeros((n_views, n_points), np.bool_), n_views - 1
    for v in range(n_views):
        for m in range(n_points):
            total = seen[v, m, 0] + seen[v, m, 1] + seen[v, m, 2] + seen[v, m, 3]
            valid[v, m] = math.isfinite(total)
            if valid[v, m]:
                du = (seen[v, m, 0] - seen[now, m, 0]) * focal[0]
                dv = (seen[v, m, 1] - seen[now, m, 1]) * focal[1]
                flow = math.sqrt(du * du + dv * dv)
                drift = track_length[v, body[m]] * drift_per_frame_px**2
                if math.isfinite(flow):
                    drift += (drift_per_flow * flow) ** 2
                by_difference[v, m] = math.sqrt(0.5) / sigma_px
                by_sum[v, m] = math.sqrt(0.5) / math.sqrt(sigma_px**2 + 2.0 * drift)
    return by_difference, by_sum, valid


def world_points(
    point: FloatArray, T_world_cam0: FloatArray, body: IntArray, N_inverse: FloatArray,
    K: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """World points (M, 3), covariance (M, 3, 3) and derivative by twists (M, 3, 6).

    `point` (M, 3): (x, y, 1/z) in the left camera `T_world_cam0` (B, 4, 4) of its `body` (M,), with
    covariance `N_inverse` (M, 3, 3); minus `K` (M, 6, 3), transposed, is its derivative.
    """
    n = len(point)
    p, C, by_twist = np.empty((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 6))
    J, JN = np.empty((3, 3)), np.empty((3, 3))
    for m in range(n):
        T, z = T_world_cam0[body[m]], 1.0 / point[m, 2]
        for a in range(3):
            ray = T[a, 0] * point[m, 0] + T[a, 1] * point[m, 1] + T[a, 2]
            p[m, a] = ray * z + T[a, 3]
            J[a, 0], J[a, 1], J[a, 2] = T[a, 0] * z, T[a, 1] * z, -ray * z * z
        for a in range(3):
            for b in range(3):
                JN[a, b] = 0.0
                for c in range(3):
                    JN[a, b] += J[a, c] * N_inverse[m, c, b]
            for b in range(6):
                for c in range(3):
                    by_twist[m, a, b] -= J[a, c] * K[m, b, c]
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    C[m, a, b] += JN[a, c] * J[b, c]
    return p, C, by_twist


def twists_about(
    T_now_then: FloatArray, T_world_cam0: FloatArray, origin: FloatArray, span_s: FloatArray
) -> FloatArray:
    """Twists (B, 6), (ω, v), in world axes about origins (B, 3), m, over spans (B,), s.

    `T_now_then` (B, 4, 4): motions in the left camera `T_world_cam0` (4, 4). The logarithm of
    `geometry.se3`; NaN for a rotation near half a turn, where its antisymmetric part vanishes.
    """
    out, M, R, t = np.empty((len(origin), 6)), np.empty((3, 4)), np.empty((3, 3)), np.empty(3)
    T = T_world_cam0
    for b in range(len(origin)):
        for i in range(3):
            for j in range(4):
                M[i, j] = T[i, 3] if j == 3 else 0.0
                for k in range(3):
                    M[i, j] += T[i, k] * T_now_then[b, k, j]
        for i in range(3):
            for j in range(3):
                R[i, j] = M[i, 0] * T[j, 0] + M[i, 1] * T[j, 1] + M[i, 2] * T[j, 2]
        for i in range(3):
            t[i] = M[i, 3] - origin[b, i]
            for j in range(3):
                t[i] += R[i, j] * (origin[b, j] - T[j, 3])
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        sine = 0.5 * math.sqrt(x * x + y * y + z * z)
        angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
        scale = 0.5 * (1.0 + angle * angle / 6.0 if angle < _SMALL_ANGLE else angle / sine)
        if angle > _NEAR_PI:
            scale = math.nan
        w = (scale * x, scale * y, scale * z)
        d = 1.0 / 12.0 + angle * angle / 720.0
        if angle >= _SERIES_ANGLE:
            d = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / (angle * angle)
        once = cross(w, (t[0], t[1], t[2]))
        twice = cross(w, once)
        for i in range(3):
            out[b, i] = w[i] / span_s[b]
            out[b, 3 + i] = (t[i] - 0.5 * once[i] + d * twice[i]) / span_s[b]
    return out


_FOLDER = code_folder(Path(__file__))
velocity_distance_compiled = compiled(velocity_distance, _FOLDER)
least_distance_compiled = compiled(least_distance, _FOLDER)
height_above_ground_compiled = compiled(height_above_ground, _FOLDER)
view_weights_compiled = compiled(view_weights, _FOLDER)
twists_about_compiled = compiled(twists_about, _FOLDER)
world_points_compiled = compiled(world_points, _FOLDER)
