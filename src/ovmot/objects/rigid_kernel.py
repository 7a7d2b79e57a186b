"""The compiled RANSAC search for the rigid motion that most points share.

tests/objects/test_rigid_kernel.py holds its plain NumPy twin.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part

HEIGHT_SIGMAS = 4.0
"""A triangle flatter than this many sigmas of its corners has no rotation."""


def best_motion(
    triples: IntArray,
    p: FloatArray,
    q: FloatArray,
    sigma: FloatArray,
    seen: FloatArray,
    weight: FloatArray,
    T_cam1_cam0: FloatArray,
    least_cosine: float,
    gate: float,
    turn_penalty: float,
) -> tuple[float, FloatArray, BoolArray]:
    """The cost, motion (4, 4) and inliers (n,) of the best of all proposals p -> q.

    Each of the triples (H, 3) proposes its mean translation and, unless it is degenerate or the
    cosine of its turn is below `least_cosine`, its rigid motion. `p`, `q` (n, 3): points then and
    now in the left camera, `sigma` (n,): their standard deviations, metres. `seen` (n, 4): the
    normalized coordinates now in both views, `weight` (n, 4, 4): their inverse covariance. The cost
    is the sum of squared Mahalanobis distances, each at most `gate`, plus `turn_penalty` for a
    motion with a rotation.
    """
    best_cost, best, T = np.inf, np.eye(4), np.eye(4)
    inlier = np.zeros(len(p), dtype=np.bool_)
    for h in range(len(triples)):
        i, j, k = triples[h, 0], triples[h, 1], triples[h, 2]
        wi, wj, wk = sigma[i] ** -2.0, sigma[j] ** -2.0, sigma[k] ** -2.0
        for a in range(3):
            for b in range(3):
                T[a, b] = 1.0 if a == b else 0.0
            moved = wi * (q[i, a] - p[i, a]) + wj * (q[j, a] - p[j, a]) + wk * (q[k, a] - p[k, a])
            T[a, 3] = moved / (wi + wj + wk)
        cost = _cost(T, p, seen, weight, T_cam1_cam0, gate, best_cost)
        if cost < best_cost:
            best_cost = cost
            _copy(T, best)
        wide = HEIGHT_SIGMAS * max(sigma[i], sigma[j], sigma[k])
        if not _height(q[i], q[j], q[k]) > wide:
            continue
        _register(p[i], p[j], p[k], q[i], q[j], q[k], T)
        if not 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0) > least_cosine:
            continue
        cost = turn_penalty + _cost(T, p, seen, weight, T_cam1_cam0, gate, best_cost - turn_penalty)
        if cost < best_cost:
            best_cost = cost
            _copy(T, best)
    for n in range(len(p)):
        inlier[n] = _distance(best, p[n], seen[n], weight[n], T_cam1_cam0) < gate
    return best_cost, best, inlier


@part
def _copy(T: FloatArray, out: FloatArray) -> None:
    """Copy a matrix (4, 4)."""
    for a in range(4):
        for b in range(4):
            out[a, b] = T[a, b]


@part
def _cost(
    T: FloatArray,
    p: FloatArray,
    seen: FloatArray,
    weight: FloatArray,
    T_cam1_cam0: FloatArray,
    gate: float,
    bound: float,
) -> float:
    """Sum of squared distances, each at most `gate`; stops once it is beyond the bound."""
    total = 0.0
    for n in range(len(p)):
        total += min(_distance(T, p[n], seen[n], weight[n], T_cam1_cam0), gate)
        if total >= bound:
            break
    return total


@part
def _distance(
    T: FloatArray, p: FloatArray, seen: FloatArray, weight: FloatArray, T_cam1_cam0: FloatArray
) -> float:
    """Squared Mahalanobis distance of a point p (3,), moved by T, from its stereo pair (4,)."""
    x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    S = T_cam1_cam0
    x1 = S[0, 0] * x + S[0, 1] * y + S[0, 2] * z + S[0, 3]
    y1 = S[1, 0] * x + S[1, 1] * y + S[1, 2] * z + S[1, 3]
    z1 = S[2, 0] * x + S[2, 1] * y + S[2, 2] * z + S[2, 3]
    r = (seen[0] - x / z, seen[1] - y / z, seen[2] - x1 / z1, seen[3] - y1 / z1)
    total = 0.0
    for a in range(4):
        for b in range(4):
            total += r[a] * weight[a, b] * r[b]
    return total


@part
def _height(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Smallest height of a triangle, metres."""
    first = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
    second = (c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2 + (c[2] - b[2]) ** 2
    third = (a[0] - c[0]) ** 2 + (a[1] - c[1]) ** 2 + (a[2] - c[2]) ** 2
    along = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1])
    along += (b[2] - a[2]) * (c[2] - b[2])
    area = math.sqrt(max(first * second - along**2, 0.0))
    return area / max(math.sqrt(max(first, second, third)), 1e-12)


@part
def _register(
    p0: FloatArray, p1: FloatArray, p2: FloatArray, q0: FloatArray, q1: FloatArray, q2: FloatArray,
    T: FloatArray,
) -> None:  # fmt: skip
    """Least-squares rigid motion T (4, 4) of a triangle p to a triangle q.

    Both are flat: the normals meet, and the turn in the plane is Procrustes' in two dimensions.
    """
    P, x0, y0 = _in_own_axes(p0, p1, p2)
    Q, u0, v0 = _in_own_axes(q0, q1, q2)
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
def _in_own_axes(
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


best_motion_compiled = compiled(best_motion, code_folder(Path(__file__)))
