"""The compiled search for the rigid motions of clustered points: sequential RANSAC.

Triples propose motions, scored by truncated Mahalanobis distances of the reprojection (P. Torr, A.
Zisserman, MLESAC, 2000); so many are drawn that one without outlier is likely to be among them (M.
Fischler, R. Bolles, 1981). tests/objects/test_rigid_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.objects.triangle_kernel import register_triangle, smallest_height

HEIGHT_SIGMAS = 4.0
"""A triangle flatter than this many sigmas of its corners has no rotation."""
SHARE_OF_POINTS = 0.7
"""Of the row with most points, that a row must hold to be used."""
TRIPLES = math.ceil(math.log(0.01) / math.log(1.0 - 0.5**3))
"""With a probability of 1 % all of them have an outlier, where a body has half of the points."""


class SeenPoints(NamedTuple):
    """M points of L earlier rows, as `MotionHistory` has them; `span_s` (L,)."""

    predicted: FloatArray
    p: FloatArray
    cov: FloatArray
    now: FloatArray
    weight: FloatArray
    information: FloatArray
    span_s: FloatArray


class Tolerance(NamedTuple):
    """When a point agrees with a motion, and which motions are possible.

    `gate`: of the squared distance of a stereo pair; `turn_penalty`: by which the sum must be less
    with a rotation; `max_turn_rps`; `accel_mps2`: standard deviation of a body's acceleration.
    """

    T_cam1_cam0: FloatArray
    gate: float
    turn_penalty: float
    max_turn_rps: float
    accel_mps2: float
    min_points: int


class Motions(NamedTuple):
    """B rigid motions of K points: `point` (K,): their indices, `size` (B,) of each motion's.

    `group` (B,): the cluster, `row` (B,): the earlier row, `T_now_then` (B, 4, 4) in the present
    left camera, on points that the ego motion has taken there. `velocity_row` (B,): the row by
    which the body's velocity is known best.
    """

    point: IntArray
    size: IntArray
    group: IntArray
    row: IntArray
    T_now_then: FloatArray
    velocity_row: IntArray


class Sample(NamedTuple):
    """n points of one search: then `p` and now `q` (n, 3), their `sigma` (n,), metres.

    `seen` (n, 4): normalized coordinates now, with their inverse covariance `weight` (n, 4, 4).
    """

    p: FloatArray
    q: FloatArray
    sigma: FloatArray
    seen: FloatArray
    weight: FloatArray


def extract_motions(
    points: SeenPoints,
    index: IntArray,
    size: IntArray,
    tolerance: Tolerance,
    rng: np.random.Generator,
) -> Motions:
    """The motions in clusters of points, in the order in which RANSAC finds them.

    `index` (K,): the points of the clusters, one after the other, `size` (G,). Each motion's
    inliers are taken out before the next search, since a cluster may hold two bodies.
    """
    n_max, least = len(index), tolerance.min_points
    most = n_max // max(least, 1)
    out = Motions(
        np.empty(n_max, np.int64), np.empty(most, np.int64), np.empty(most, np.int64),
        np.empty(most, np.int64), np.empty((most, 4, 4)), np.empty(most, np.int64),
    )  # fmt: skip
    remaining, of_row = np.empty(n_max, np.int64), np.empty(n_max, np.int64)
    inlier = np.empty(n_max, np.bool_)
    n_found, n_points, start = 0, 0, 0
    for g in range(len(size)):
        n = size[g]
        for k in range(n):
            remaining[k] = index[start + k]
        start += n
        while n >= least:
            # an acceleration is common to the points of a body: it does not limit the span here
            row = best_row(points.weight, points.information, remaining[:n], points.span_s, 0.0)
            m = 0
            for k in range(n):
                if points.weight[remaining[k], row, 0, 0] > 0.0:
                    of_row[m] = remaining[k]
                    m += 1
            if m < least:
                break
            least_cosine = math.cos(tolerance.max_turn_rps * points.span_s[row])
            found = ransac(
                sample_of(points, of_row[:m], row), tolerance.T_cam1_cam0, tolerance.gate,
                tolerance.turn_penalty, least_cosine, rng, out.T_now_then[n_found], inlier,
            )  # fmt: skip
            if found < least:
                break
            out.size[n_found], out.group[n_found], out.row[n_found] = found, g, row
            body = n_points
            for k in range(m):
                if inlier[k]:
                    out.point[n_points] = of_row[k]
                    n_points += 1
            out.velocity_row[n_found] = best_row(
                points.weight, points.information, out.point[body:n_points], points.span_s,
                tolerance.accel_mps2,
            )  # fmt: skip
            n_found += 1
            n = without(remaining[:n], of_row[:m], inlier)
    return Motions(
        out.point[:n_points], out.size[:n_found], out.group[:n_found], out.row[:n_found],
        out.T_now_then[:n_found], out.velocity_row[:n_found],
    )  # fmt: skip


@part
def without(remaining: IntArray, of_row: IntArray, inlier: BoolArray) -> int:
    """How many of the points remain, in order, without the inliers among those of the row."""
    kept, k = 0, 0
    for r in range(len(remaining)):
        if k < len(of_row) and of_row[k] == remaining[r]:
            k += 1
            if inlier[k - 1]:
                continue
        remaining[kept] = remaining[r]
        kept += 1
    return kept


@part
def best_row(
    weight: FloatArray, information: FloatArray, index: IntArray, span_s: FloatArray,
    accel_mps2: float,
) -> int:  # fmt: skip
    """The earlier row with the least expected squared error of the velocity of points (n,).

    The part of the points' noise falls with the span and with their number; that of an acceleration
    of standard deviation `accel_mps2` grows with the span. The displacement's error is the trace of
    the inverse of the summed `information` (M, L, 3, 3); a point is seen in a row where its
    `weight` (M, L, 4, 4) is not zero.
    """
    count, most = np.zeros(len(span_s), np.int64), 0
    for row in range(len(span_s)):
        for n in index:
            count[row] += weight[n, row, 0, 0] > 0.0
        most = max(most, count[row])
    best, least, total = 0, np.inf, np.empty((3, 3))
    for row in range(len(span_s)):
        for a in range(3):
            for b in range(3):
                total[a, b] = 1e-6 if a == b else 0.0
        for n in index:
            for a in range(3):
                for b in range(3):
                    total[a, b] += information[n, row, a, b]
        A = total[1, 1] * total[2, 2] - total[1, 2] * total[2, 1]
        B = total[1, 2] * total[2, 0] - total[1, 0] * total[2, 2]
        C = total[1, 0] * total[2, 1] - total[1, 1] * total[2, 0]
        minors = A + total[0, 0] * total[2, 2] - total[0, 2] * total[2, 0]
        minors += total[0, 0] * total[1, 1] - total[0, 1] * total[1, 0]
        trace = minors / (total[0, 0] * A + total[0, 1] * B + total[0, 2] * C)
        error = trace / span_s[row] ** 2 + 2.0 * (0.5 * accel_mps2 * span_s[row]) ** 2
        if count[row] >= SHARE_OF_POINTS * most and error < least:
            best, least = row, error
    return best


@part
def sample_of(points: SeenPoints, index: IntArray, row: int) -> Sample:
    """The points (n,) of one row, one after the other."""
    n = len(index)
    s = Sample(
        np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((n, 4)), np.empty((n, 4, 4))
    )
    for k in range(n):
        m = index[k]
        s.sigma[k] = math.sqrt(points.cov[m, 2, 2])
        for a in range(3):
            s.p[k, a], s.q[k, a] = points.predicted[m, row, a], points.p[m, a]
        for a in range(4):
            s.seen[k, a] = points.now[m, a]
            for b in range(4):
                s.weight[k, a, b] = points.weight[m, row, a, b]
    return s


@part
def ransac(
    s: Sample, T_cam1_cam0: FloatArray, gate: float, turn_penalty: float, least_cosine: float,
    rng: np.random.Generator, best: FloatArray, inlier: BoolArray,
) -> int:  # fmt: skip
    """The number of inliers of the motion `best` (4, 4) that most of the points p -> q share.

    Each triple proposes its mean translation and, unless it is degenerate or the cosine of its turn
    is below `least_cosine`, its rigid motion. The cost is the sum of squared Mahalanobis distances,
    each at most `gate`, plus `turn_penalty` for a motion with a rotation.
    """
    n, best_cost, n_inliers = len(s.p), np.inf, 0
    T, both = np.eye(4), np.empty((3, 4))
    copy_motion(T, best)
    for _ in range(TRIPLES):
        i, j, k = draw_triple(n, rng)
        for turn in range(2):
            if not propose(s, i, j, k, turn, least_cosine, T):
                break
            into_right(T_cam1_cam0, T, both)
            total = turn_penalty * turn
            for m in range(n):
                if total >= best_cost:
                    break
                total += min(squared_distance(T, both, s.p, s.seen, s.weight, m), gate)
            if total < best_cost:
                best_cost = total
                copy_motion(T, best)
    into_right(T_cam1_cam0, best, both)
    for m in range(n):
        inlier[m] = squared_distance(best, both, s.p, s.seen, s.weight, m) < gate
        n_inliers += inlier[m]
    return n_inliers


@inlined_part
def propose(
    s: Sample, i: int, j: int, k: int, turn: int, least_cosine: float, T: FloatArray
) -> bool:
    """The motion T (4, 4) of a triple, its translation alone or with a turn; False for none."""
    if turn == 0:
        wi, wj, wk = s.sigma[i] ** -2.0, s.sigma[j] ** -2.0, s.sigma[k] ** -2.0
        for a in range(3):
            for b in range(3):
                T[a, b] = 1.0 if a == b else 0.0
            moved = wi * (s.q[i, a] - s.p[i, a]) + wj * (s.q[j, a] - s.p[j, a])
            moved += wk * (s.q[k, a] - s.p[k, a])
            T[a, 3] = moved / (wi + wj + wk)
        return True
    wide = HEIGHT_SIGMAS * max(s.sigma[i], s.sigma[j], s.sigma[k])
    if not smallest_height(s.q[i], s.q[j], s.q[k]) > wide:
        return False
    register_triangle(s.p[i], s.p[j], s.p[k], s.q[i], s.q[j], s.q[k], T)
    return bool(0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0) > least_cosine)


@part
def draw_triple(n: int, rng: np.random.Generator) -> tuple[int, int, int]:
    """Three different indices below n: those of the least of n random numbers."""
    i, j, k = 0, 0, 0
    a, b, c = np.inf, np.inf, np.inf
    for m in range(n):
        x = rng.random()
        if x < a:
            i, j, k, a, b, c = m, i, j, x, a, b
        elif x < b:
            j, k, b, c = m, j, x, b
        elif x < c:
            k, c = m, x
    return i, j, k


@inlined_part
def copy_motion(T: FloatArray, out: FloatArray) -> None:
    """Copy a matrix (4, 4)."""
    for a in range(4):
        for b in range(4):
            out[a, b] = T[a, b]


@inlined_part
def into_right(T_cam1_cam0: FloatArray, T: FloatArray, out: FloatArray) -> None:
    """out (3, 4): the motion, then into the right camera."""
    for a in range(3):
        for b in range(4):
            out[a, b] = T_cam1_cam0[a, 3] if b == 3 else 0.0
            for c in range(3):
                out[a, b] += T_cam1_cam0[a, c] * T[c, b]


@inlined_part
def squared_distance(
    T: FloatArray, S: FloatArray, p: FloatArray, seen: FloatArray, weight: FloatArray, m: int
) -> float:
    """Squared Mahalanobis distance of point m, moved by T, and by S as the right camera sees it."""
    x, y, z = p[m, 0], p[m, 1], p[m, 2]
    per_z = 1.0 / (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3])
    per_z1 = 1.0 / (S[2, 0] * x + S[2, 1] * y + S[2, 2] * z + S[2, 3])
    a = seen[m, 0] - (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) * per_z
    b = seen[m, 1] - (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) * per_z
    c = seen[m, 2] - (S[0, 0] * x + S[0, 1] * y + S[0, 2] * z + S[0, 3]) * per_z1
    d = seen[m, 3] - (S[1, 0] * x + S[1, 1] * y + S[1, 2] * z + S[1, 3]) * per_z1
    total = weight[m, 0, 0] * a * a + weight[m, 1, 1] * b * b
    total += weight[m, 2, 2] * c * c + weight[m, 3, 3] * d * d
    crossed = a * (weight[m, 0, 1] * b + weight[m, 0, 2] * c + weight[m, 0, 3] * d)
    crossed += b * (weight[m, 1, 2] * c + weight[m, 1, 3] * d) + weight[m, 2, 3] * c * d
    return float(total + 2.0 * crossed)


extract_motions_compiled = compiled(extract_motions, code_folder(Path(__file__)))
