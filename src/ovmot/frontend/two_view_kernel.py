"""The compiled two-view test: one translation for all points, their rotation being known.

With the rotation that the IMU measures, two points determine the direction of the translation, so
that a sample is rarely spoiled (C. Troiani et al., ICRA 2014; K. Sun et al., RA-L 2018).
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import cross, eigen_symmetric

_ROUNDS = 3
"""Fits to the inliers of the best sample: the set hardly changes after the second."""


@part
def _distance2(
    t: FloatArray, R: FloatArray, turned: FloatArray, seen: FloatArray, normal: FloatArray
) -> float:
    """Squared Sampson distance of a pair from the translation `t` (3,); `turned` (3,) is the ray of
    before turned by R, `seen` that of now, `normal` their cross product."""
    off = t[0] * normal[0] + t[1] * normal[1] + t[2] * normal[2]
    now_u = t[1] * turned[2] - t[2] * turned[1]
    now_v = t[2] * turned[0] - t[0] * turned[2]
    x = seen[1] * t[2] - seen[2] * t[1]
    y = seen[2] * t[0] - seen[0] * t[2]
    z = seen[0] * t[1] - seen[1] * t[0]
    before_u = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    before_v = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    size = now_u * now_u + now_v * now_v + before_u * before_u + before_v * before_v
    return float(off * off / size) if size > 0.0 else 0.0


@part
def _cost(
    t: FloatArray, R: FloatArray, turned: FloatArray, seen: FloatArray, normal: FloatArray,
    fitted: IntArray, bound: float, most: float,
) -> float:  # fmt: skip
    """Sum over the `fitted` pairs of squared distances, each `bound` at most; more than `most` is
    not added up to the end."""
    cost = 0.0
    for n in fitted:
        cost += min(_distance2(t, R, turned[n], seen[n], normal[n]), bound)
        if cost > most:
            break
    return cost


@part
def _fit(
    t: FloatArray, R: FloatArray, turned: FloatArray, seen: FloatArray, normal: FloatArray,
    fitted: IntArray, bound: float, out: FloatArray,
) -> None:  # fmt: skip
    """Fill `out` (3,): the unit vector that is most nearly in all planes of the inliers of `t`."""
    squares, values, axes = np.zeros((3, 3)), np.empty(3), np.empty((3, 3))
    for n in fitted:
        if _distance2(t, R, turned[n], seen[n], normal[n]) <= bound:
            for i in range(3):
                for j in range(3):
                    squares[i, j] += normal[n, i] * normal[n, j]
    eigen_symmetric(squares, values, axes)
    k = np.argmin(values)
    for i in range(3):
        out[i] = axes[i, k]


def agree_with_translation(
    before: FloatArray, now: FloatArray, R: FloatArray, threshold: float,
    fitted: IntArray, n_samples: int,
) -> BoolArray:  # fmt: skip
    """Which of the pairs (N,) are within `threshold` of the translation that most agree with.

    `before`, `now` (N, 2): finite normalized coordinates; R (3, 3) turns rays of before into those
    of now; `threshold` of the Sampson distance, in the same unit. The translation is found from
    `n_samples` of two of the `fitted` (M,) pairs, always the same ones.
    """
    n_pairs, bound = len(before), threshold * threshold
    turned, seen, normal = np.empty((n_pairs, 3)), np.empty((n_pairs, 3)), np.empty((n_pairs, 3))
    for n in range(n_pairs):
        u, v = before[n]
        for i in range(3):
            turned[n, i] = R[i, 0] * u + R[i, 1] * v + R[i, 2]
        seen[n, 0], seen[n, 1], seen[n, 2] = now[n, 0], now[n, 1], 1.0
        normal[n, 0], normal[n, 1], normal[n, 2] = cross(turned[n], seen[n])
    best, t, least = np.zeros(3), np.empty(3), np.inf
    state = np.uint64(1)
    for _ in range(n_samples):
        # Knuth's linear congruential generator of 64 bits (MMIX); its upper bits
        state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
        one = fitted[np.int64((state >> np.uint64(33)) % np.uint64(len(fitted)))]
        state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
        other = fitted[np.int64((state >> np.uint64(33)) % np.uint64(len(fitted)))]
        a, b = normal[one], normal[other]
        x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        size = math.sqrt(x * x + y * y + z * z)
        if not size > 0.0:
            continue
        t[0], t[1], t[2] = x / size, y / size, z / size
        cost = _cost(t, R, turned, seen, normal, fitted, bound, least)
        if cost < least:
            least = cost
            best[0], best[1], best[2] = t[0], t[1], t[2]
    for _ in range(_ROUNDS):
        _fit(best, R, turned, seen, normal, fitted, bound, t)
        cost = _cost(t, R, turned, seen, normal, fitted, bound, least)
        if not cost < least:
            break
        least = cost
        best[0], best[1], best[2] = t[0], t[1], t[2]
    inlier = np.zeros(n_pairs, dtype=np.bool_)
    for n in range(n_pairs):
        inlier[n] = _distance2(best, R, turned[n], seen[n], normal[n]) <= bound
    return inlier


agree_with_translation_compiled = compiled(agree_with_translation, code_folder(Path(__file__)))
