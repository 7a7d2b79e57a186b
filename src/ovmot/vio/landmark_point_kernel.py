"""The compiled places of SLAM features: points with Jacobians, new ones, and changes of anchor.

The arguments `form` and `axes` of a representation: see `landmarks.Coordinates`. The plain NumPy
twins of the coordinates are the classes of `vio.landmarks`; tests/vio/test_slam_features.py holds
the others against finite differences and against the best fit.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.stereo import transform

EUCLIDEAN, SPHERICAL, NORMALIZED = 0, 1, 2
_POSE = 6  # coordinates of a clone


@part
def point_of(form: int, axes: FloatArray, value: FloatArray, p: FloatArray, J: FloatArray) -> None:
    """Point p (3,) of a value (3,), and its derivative J (3, 3)."""
    for i in range(3):
        for j in range(3):
            J[i, j] = 1.0 if i == j else 0.0
    if form == EUCLIDEAN:
        for i in range(3):
            p[i] = value[i]
        return
    rho = value[2]
    if form == NORMALIZED:
        p[0], p[1], p[2] = value[0] / rho, value[1] / rho, 1.0 / rho
        J[0, 0] = J[1, 1] = 1.0 / rho
        J[0, 2], J[1, 2], J[2, 2] = -p[0] / rho, -p[1] / rho, -p[2] / rho
        return
    ct, st = math.cos(value[0]), math.sin(value[0])
    cp, sp = math.cos(value[1]), math.sin(value[1])
    for i in range(3):
        p[i] = (axes[i, 0] * cp * ct + axes[i, 1] * cp * st + axes[i, 2] * sp) / rho
        J[i, 0] = (axes[i, 1] * cp * ct - axes[i, 0] * cp * st) / rho
        J[i, 1] = (axes[i, 2] * cp - axes[i, 0] * sp * ct - axes[i, 1] * sp * st) / rho
        J[i, 2] = -p[i] / rho


@part
def value_of(form: int, axes: FloatArray, p: FloatArray, value: FloatArray) -> None:
    """Value (3,) of a point p (3,)."""
    if form == EUCLIDEAN:
        for i in range(3):
            value[i] = p[i]
    elif form == NORMALIZED:
        value[0], value[1], value[2] = p[0] / p[2], p[1] / p[2], 1.0 / p[2]
    else:
        x = axes[0, 0] * p[0] + axes[1, 0] * p[1] + axes[2, 0] * p[2]
        y = axes[0, 1] * p[0] + axes[1, 1] * p[1] + axes[2, 1] * p[2]
        z = axes[0, 2] * p[0] + axes[1, 2] * p[1] + axes[2, 2] * p[2]
        distance = math.sqrt(x * x + y * y + z * z)
        value[0], value[1] = math.atan2(y, x), math.asin(z / distance)
        value[2] = 1.0 / distance


@part
def place(
    form: int, axes: FloatArray, value: FloatArray, anchor: int, poses: FloatArray,
    T_imu_anchor: FloatArray, p_world: FloatArray, by_value: FloatArray, by_anchor: FloatArray,
) -> None:  # fmt: skip
    """World point (3,) of a value (3,), by the value (3, 3) and by the anchor's pose (3, 6).

    `anchor`: index in the `poses` T_world_imu (K, 4, 4), -1 for none; then `by_anchor` stays.
    """
    if anchor < 0:
        point_of(form, axes, value, p_world, by_value)
        return
    p, p_imu, J, turned = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    point_of(form, axes, value, p, J)
    transform(T_imu_anchor, p, p_imu)
    T = poses[anchor]
    transform(T, p_imu, p_world)
    for i in range(3):
        for j in range(3):
            turned[i, j] = 0.0
            for k in range(3):
                turned[i, j] += T_imu_anchor[i, k] * J[k, j]
    for i in range(3):
        for j in range(3):
            by_value[i, j] = 0.0
            by_anchor[i, 3 + j] = 1.0 if i == j else 0.0
            for k in range(3):
                by_value[i, j] += T[i, k] * turned[k, j]
        by_anchor[i, 0] = T[i, 2] * p_imu[1] - T[i, 1] * p_imu[2]
        by_anchor[i, 1] = T[i, 0] * p_imu[2] - T[i, 2] * p_imu[0]
        by_anchor[i, 2] = T[i, 1] * p_imu[0] - T[i, 0] * p_imu[1]


@part
def replace_value(
    form: int, axes: FloatArray, p_world: FloatArray, anchor: int, poses: FloatArray,
    T_imu_anchor: FloatArray, value: FloatArray,
) -> None:  # fmt: skip
    """Value (3,) of a world point (3,); the inverse of `place`."""
    if anchor < 0:
        value_of(form, axes, p_world, value)
        return
    p_imu, p, T = np.empty(3), np.empty(3), poses[anchor]
    for i in range(3):
        p_imu[i] = 0.0
        for k in range(3):
            p_imu[i] += T[k, i] * (p_world[k] - T[k, 3])
    for i in range(3):
        p[i] = 0.0
        for k in range(3):
            p[i] += T_imu_anchor[k, i] * (p_imu[k] - T_imu_anchor[k, 3])
    value_of(form, axes, p, value)


@part
def invert(A: FloatArray, out: FloatArray) -> None:
    """Inverse (3, 3) of a matrix, by cofactors."""
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            out[j, i] = A[a, c] * A[b, d] - A[a, d] * A[b, c]
    det = A[0, 0] * out[0, 0] + A[0, 1] * out[1, 0] + A[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= det


def place_landmarks(
    form: int, axes: FloatArray, value: FloatArray, anchor: IntArray, poses: FloatArray,
    T_imu_anchor: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """World points (L, 3), by the values (L, 3, 3) and by the anchors' poses (L, 3, 6).

    `value` (L, 3); `anchor` (L,): index in the `poses` T_world_imu (K, 4, 4), -1 for none.
    """
    n = len(value)
    p, by_value, by_anchor = np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 3, _POSE))
    for k in range(n):
        place(form, axes, value[k], anchor[k], poses, T_imu_anchor, p[k], by_value[k], by_anchor[k])
    return p, by_value, by_anchor


@part
def _change_jacobian(
    to_value: FloatArray, before: FloatArray, by_old: FloatArray, by_new: FloatArray, J: FloatArray
) -> None:
    """J (s, s + 12) of a new value by the old value, by the old anchor's pose and by the new one's.

    `to_value` (3, 3): of the new value by the point; `before` (3, 3), `by_old`, `by_new` (3, 6): of
    the point. J is zero before.
    """
    size = len(J)
    for a in range(size):
        for i in range(3):
            by_point = to_value[3 - size + a, i]
            for c in range(size):
                J[a, c] += by_point * before[i, 3 - size + c]
            for c in range(_POSE):
                J[a, size + c] += by_point * by_old[i, c]
                J[a, size + _POSE + c] -= by_point * by_new[i, c]


def change_anchors(
    form: int,
    axes: FloatArray,
    size: int,
    values: tuple[FloatArray, FloatArray],
    index: IntArray,
    anchors: tuple[int, int],
    poses: tuple[FloatArray, FloatArray],
    T_imu_anchor: FloatArray,
    P: FloatArray,
    first_clone: int,
    first_landmark: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values, first estimates (L, 3) and covariance (N, N), landmarks `index` (M,) anchored anew.

    `values`: latest and first estimates (L, 3); `anchors`: clones, the old one and the new one;
    `poses`: T_world_imu (K, 4, 4) by latest and first estimates. A new value depends on the old
    one, on both anchors' poses, and on nothing else.
    """
    latest, first, n = values[0].copy(), values[1].copy(), len(P)
    p, before, after = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    by_old, by_new, to_value = np.empty((3, _POSE)), np.empty((3, _POSE)), np.empty((3, 3))
    width = size + 2 * _POSE
    J, column = np.zeros((size * len(index), width)), np.empty((len(index), width), np.int64)
    for m in range(len(index)):
        k = index[m]
        place(form, axes, latest[k], anchors[0], poses[0], T_imu_anchor, p, before, by_old)
        replace_value(form, axes, p, anchors[1], poses[0], T_imu_anchor, latest[k])
        place(form, axes, first[k], anchors[0], poses[1], T_imu_anchor, p, before, by_old)
        replace_value(form, axes, p, anchors[1], poses[1], T_imu_anchor, first[k])
        place(form, axes, first[k], anchors[1], poses[1], T_imu_anchor, p, after, by_new)
        invert(after, to_value)
        for c in range(size):
            column[m, c] = first_landmark + size * k + c
        for c in range(_POSE):
            column[m, size + c] = first_clone + _POSE * anchors[0] + c
            column[m, size + _POSE + c] = first_clone + _POSE * anchors[1] + c
        _change_jacobian(to_value, before, by_old, by_new, J[size * m : size * m + size])
    covariance, cross = P.copy(), np.zeros((len(J), n))
    for r in range(len(J)):
        for c in range(width):
            for j in range(n):
                cross[r, j] += J[r, c] * P[column[r // size, c], j]
    for r in range(len(J)):
        at = column[r // size, r % size]
        for j in range(n):
            covariance[at, j] = covariance[j, at] = cross[r, j]
    for r in range(len(J)):
        at = column[r // size, r % size]
        for q in range(r + 1):
            total = 0.0
            for c in range(width):
                total += cross[r, column[q // size, c]] * J[q, c]
            to = column[q // size, q % size]
            covariance[at, to] = covariance[to, at] = total
    return latest, first, covariance


@part
def _solved_rows(
    R: FloatArray, E: FloatArray, by_value: FloatArray, by_anchor: FloatArray, at: int, size: int,
    G: FloatArray, inverse: FloatArray,
) -> None:  # fmt: skip
    """G (s, k + 1) = A⁻¹ [-B | r] of the rows A v + B x = r of a value, and A⁻¹ (s, s).

    From the rows of its point, R δp + E (x, -1) = noise, with the derivatives of the point by the
    value and by the anchor's pose, which is at column `at`, -1 for none. Of a value with one
    coordinate the bearing is projected out: what is square to both its columns stays.
    """
    A, B, last = np.zeros((3, 3)), E.copy(), E.shape[1] - 1
    for i in range(3):
        for k in range(3):
            for j in range(3):
                A[i, j] += R[i, k] * by_value[k, j]
            for j in range(_POSE if at >= 0 else 0):
                B[i, at + j] += R[i, k] * by_anchor[k, j]
    if size == 3:
        invert(A, inverse)
    else:
        n = np.empty(3)
        n[0] = A[1, 0] * A[2, 1] - A[2, 0] * A[1, 1]
        n[1] = A[2, 0] * A[0, 1] - A[0, 0] * A[2, 1]
        n[2] = A[0, 0] * A[1, 1] - A[1, 0] * A[0, 1]
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        along = (n[0] * A[0, 2] + n[1] * A[1, 2] + n[2] * A[2, 2]) / length
        inverse[0, 0] = 1.0 / along
        for j in range(last + 1):
            B[0, j] = (n[0] * B[0, j] + n[1] * B[1, j] + n[2] * B[2, j]) / length
    for a in range(size):
        for j in range(last + 1):
            G[a, j] = 0.0
        for i in range(size):
            for j in range(last):
                G[a, j] -= inverse[a, i] * B[i, j]
            G[a, last] += inverse[a, i] * B[i, last]


@part
def _add_change(G: FloatArray, error: FloatArray, value: FloatArray) -> None:
    """Add to a value (s,) what G (s, k + 1), see `_solved_rows`, makes of the error (k,) of x."""
    last = G.shape[1] - 1
    for a in range(len(G)):
        change = G[a, last]
        for j in range(last):
            change += G[a, j] * error[j]
        value[a] += change


def initialize_landmarks(
    form: int,
    axes: FloatArray,
    size: int,
    p_world: FloatArray,
    R: FloatArray,
    E: FloatArray,
    anchor: int,
    poses: tuple[FloatArray, FloatArray],
    T_imu_anchor: FloatArray,
    P: FloatArray,
    columns: tuple[int, int],
    error: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values and first estimates (L, 3) of new landmarks, and the covariance augmented by them.

    `p_world` (L, 3): where they are linearized; `R` (L, 3, 3), `E` (L, 3, k + 1): the rows that
    determine their points, see `update_by_features`; `anchor`: a clone, -1 for none; `poses`: as
    above; `columns`: where x begins in P (N, N), and the clones in x; `error` (N,): of the
    estimate. The error of a value is -A⁻¹ (B x - n), with white noise n of variance 1.
    """
    n, k, old, x0 = len(p_world), E.shape[2] - 1, len(P), columns[0]
    latest, first = np.empty((n, 3)), np.empty((n, 3))
    p, by_value, by_anchor = np.empty(3), np.empty((3, 3)), np.empty((3, _POSE))
    G, inverse = np.empty((n * size, k + 1)), np.empty((n, size, size))
    at = columns[1] + _POSE * anchor if anchor >= 0 else -1
    for m in range(n):
        replace_value(form, axes, p_world[m], anchor, poses[0], T_imu_anchor, latest[m])
        replace_value(form, axes, p_world[m], anchor, poses[1], T_imu_anchor, first[m])
        place(form, axes, first[m], anchor, poses[1], T_imu_anchor, p, by_value, by_anchor)
        rows = G[m * size : m * size + size]
        _solved_rows(R[m], E[m], by_value, by_anchor, at, size, rows, inverse[m])
        _add_change(rows, error[x0 : x0 + k], latest[m, 3 - size :])
    covariance = np.zeros((old + n * size, old + n * size))
    for i in range(old):
        for j in range(old):
            covariance[i, j] = P[i, j]
    for r in range(n * size):
        cross = covariance[old + r]
        for i in range(k):
            for j in range(old):
                cross[j] += G[r, i] * P[x0 + i, j]
        for j in range(old):
            covariance[j, old + r] = cross[j]
        for q in range(r + 1):
            total = 0.0
            for i in range(k):
                total += cross[x0 + i] * G[q, i]
            if q // size == r // size:
                for i in range(size):
                    total += inverse[r // size, r % size, i] * inverse[q // size, q % size, i]
            covariance[old + r, old + q] = covariance[old + q, old + r] = total
    return latest, first, covariance


_FOLDER = code_folder(Path(__file__))
place_landmarks_compiled = compiled(place_landmarks, _FOLDER)
change_anchors_compiled = compiled(change_anchors, _FOLDER)
initialize_landmarks_compiled = compiled(initialize_landmarks, _FOLDER)
