"""The compiled search for points that may move: which to look at, and how each of them moves.

tests/objects/test_motion_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.kernels.small_matrices import add_products, squared_mahalanobis, whiten
from ovmot.kernels.stereo import project, transform
from ovmot.segmentation.comparison_kernel import (
    EgoMotion,
    Pairs,
    Scratch,
    StereoNoise,
    fit_velocity,
    image_covariance,
    motion_rows,
    new_scratch,
    predict_point,
    spread_point,
    widen,
)


class MovingPoints(NamedTuple):
    """M points that one velocity explains and that do not seem static, of L earlier frames.

    `point` (M,): indices among all points; `velocity` (M, 3) with `velocity_cov` (M, 3, 3);
    `predicted` (M, L, 3), `weight` (M, L, 4, 4), `information` (M, L, 3, 3): as `MotionHistory`.
    """

    point: IntArray
    velocity: FloatArray
    velocity_cov: FloatArray
    predicted: FloatArray
    weight: FloatArray
    information: FloatArray


class Limits(NamedTuple):
    """Which points are looked at: within `max_range_m`, at most `max_points`.

    `hint`: squared sigmas from rest that make one worth a closer look; `points_per_track`: of one
    track at most about as many.
    """

    max_range_m: float
    hint: float
    max_points: int
    points_per_track: int


class Rows(NamedTuple):
    """Comparisons of one point with L earlier rows: which are `there` (L,), and what they show.

    `residual` (L, 4), its derivative `D` (L, 4, 3) by the displacement and its covariance `S`
    (L, 4, 4) at the present place, the lower triangle; `J_now` (4, 3): of the views by the point.
    """

    there: BoolArray
    residual: FloatArray
    D: FloatArray
    S: FloatArray
    J_now: FloatArray


def points_to_look_at(
    pairs: Pairs,
    cov_now: FloatArray,
    T_now_then: FloatArray,
    seems_static: BoolArray,
    pixels: FloatArray,
    track_id: IntArray,
    limits: Limits,
) -> IntArray:
    """Points (C,) within range that do not seem static, or are beyond the hint from rest.

    Each was seen in one earlier frame at least. The squared distance is roughly that of Mahalanobis
    since the oldest frame: axes apart and with the present covariance for both times, quick, to
    spare most points the full comparison. Where there are too many, `pixels` (N, 4) and `track_id`
    (N,) tell which, see `thin_out_tracks`, and of all those the ones seen longest.
    """
    n_rows, n_points = pairs.p_then.shape[:2]
    index, known = np.empty(n_points, np.int64), np.empty(n_points, np.int64)
    count, q = 0, np.empty(3)
    for n in range(n_points):
        if not pairs.p_now[n, 2] < limits.max_range_m:
            continue
        rows, distance = 0, 0.0
        for row in range(n_rows):
            if math.isfinite(pairs.p_then[row, n, 2]):
                if rows == 0:
                    transform(T_now_then[row], pairs.p_then[row, n], q)
                    for a in range(3):
                        off = q[a] - pairs.p_now[n, a]
                        distance += off * off / (2.0 * cov_now[n, a, a])
                rows += 1
        if rows > 0 and (distance > limits.hint or not seems_static[n]):
            index[count], known[count] = n, rows
            count += 1
    count = thin_out_tracks(index, known, count, pixels, track_id, limits.points_per_track)
    count = longest_seen(index, known, count, n_rows, limits.max_points)
    return index[:count]


@part
def thin_out_tracks(
    index: IntArray, known: IntArray, count: int, pixels: FloatArray, track_id: IntArray, most: int
) -> int:
    """How many of the first points are kept, moved to the front in their order.

    Of a track's points that were `known` in more than one row as many as tell enough, from all over
    it, or a large body would leave none for the others.
    """
    dropped, own = np.zeros(count, np.bool_), np.empty(count, np.int64)
    looked_up = np.zeros(count, np.bool_)
    for first in range(count):
        track, n = track_id[index[first]], 0
        if track < 0 or looked_up[first]:
            continue
        for k in range(first, count):
            if track_id[index[k]] == track:
                looked_up[k] = True
                if known[k] > 1:
                    own[n] = k
                    n += 1
        if n > most:
            for k in own[:n]:
                rank, u = 0, pixels[index[k], 0]
                for j in own[:n]:
                    off = pixels[index[j], 0] - u
                    rank += off < 0.0 or (off == 0.0 and j < k)
                dropped[k] = rank % ((n + most - 1) // most) > 0
    kept = 0
    for k in range(count):
        if not dropped[k]:
            index[kept], known[kept] = index[k], known[k]
            kept += 1
    return kept


@part
def longest_seen(index: IntArray, known: IntArray, count: int, n_rows: int, most: int) -> int:
    """How many of the first points are kept: at most so many, in order, those `known` in most rows.

    Of those known in equally many the first ones are kept.
    """
    left, kept = most, 0
    for rows in range(n_rows, 0, -1):
        for k in range(count):
            if known[k] == rows:
                known[k] = -rows if left > 0 else 0
                left -= 1
    for k in range(count):
        if known[k] < 0:
            index[kept] = index[k]
            kept += 1
    return kept


def moving_points(
    pairs: Pairs,
    ego: EgoMotion,
    noise: StereoNoise,
    candidate: IntArray,
    track_id: IntArray,
    n_old: int,
    accel_mps2: float,
    bound: FloatArray,
    moves: float,
) -> MovingPoints:
    """Those of the candidates (C,) that one velocity explains, and that are not static by it.

    The cost of the velocity is below `bound` (L + 1,), by the number of rows, and its squared
    Mahalanobis distance from rest above `moves`. Points of tracks, by `track_id` (N,), may move by
    their last rows alone, without the `n_old` first ones: a car that brakes was faster before.
    """
    n_rows, n = len(ego.span_s), len(candidate)
    point, velocity, velocity_cov = np.empty(n, np.int64), np.empty((n, 3)), np.empty((n, 3, 3))
    predicted, weight = np.empty((n, n_rows, 3)), np.empty((n, n_rows, 4, 4))
    information = np.empty((n, n_rows, 3, 3))
    count, s, rows = 0, new_scratch(), new_rows(n_rows)
    for k in range(n):
        v, C, first, steady = velocity[count], velocity_cov[count], 0, False
        p, W, N = predicted[count], weight[count], information[count]
        compare_rows(pairs, ego, noise, candidate[k], s, rows, p)
        for step in range(3):  # all rows; the last ones; the weights of those that were used
            if step == 1:
                if steady or track_id[candidate[k]] < 0:
                    continue
                first = n_old
            if step == 2 and not (steady and squared_mahalanobis(v, C) > moves):
                break
            clear(s.products, W, N, step)
            used = 0
            for row in range(n_rows):
                if rows.there[row] and row >= first:
                    used += 1
                    add_row(row, ego.span_s[row], accel_mps2, step, s, rows, W, N)
            if step < 2:
                steady = fit_velocity(s, v, C) < bound[used]
            else:
                point[count] = candidate[k]
                count += 1
    return MovingPoints(
        point[:count], velocity[:count], velocity_cov[:count], predicted[:count], weight[:count],
        information[:count],
    )  # fmt: skip


@part
def new_rows(n_rows: int) -> Rows:
    """Memory of one point's comparisons."""
    return Rows(
        np.empty(n_rows, np.bool_), np.empty((n_rows, 4)), np.empty((n_rows, 4, 3)),
        np.empty((n_rows, 4, 4)), np.empty((4, 3)),
    )  # fmt: skip


@inlined_part
def compare_rows(
    pairs: Pairs, ego: EgoMotion, noise: StereoNoise, n: int, s: Scratch, rows: Rows,
    predicted: FloatArray,
) -> None:  # fmt: skip
    """Compare point n with its earlier rows, at its present place; `predicted` (L, 3) is filled."""
    project(pairs.p_now[n], noise.T_cam1_cam0, s.h, rows.J_now)
    for row in range(len(ego.span_s)):
        rows.there[row] = predict_point(pairs, ego, row, n, s)
        for a in range(3):
            predicted[row, a] = s.predicted[a] if rows.there[row] else np.nan
        if rows.there[row]:
            spread_point(pairs, ego, noise, row, n, s)
            image_covariance(pairs, noise, row, n, rows.J_now, s.C, s.S)
            for i in range(4):
                rows.residual[row, i] = s.residual[i]
                for j in range(4):
                    rows.S[row, i, j] = s.S[i, j]
                    if j < 3:
                        rows.D[row, i, j] = s.D[i, j]


@inlined_part
def clear(products: FloatArray, weight: FloatArray, information: FloatArray, step: int) -> None:
    """Zero the sums, and in the last step the weights and information of all rows."""
    for i in range(4):
        for j in range(4):
            products[i, j] = 0.0
    if step == 2:
        weight[:, :, :] = 0.0
        information[:, :, :] = 0.0


@inlined_part
def add_row(
    row: int, span_s: float, accel_mps2: float, step: int, s: Scratch, rows: Rows,
    weight: FloatArray, information: FloatArray,
) -> None:  # fmt: skip
    """One row's part of the normal equations of a point.

    In the last step its weight and information, (L, 4, 4) and (L, 3, 3), are filled instead.
    """
    for i in range(4):
        s.residual[i] = rows.residual[row, i]
        for j in range(4):
            s.S[i, j] = rows.S[row, i, j]
            if j < 3:
                s.D[i, j] = rows.D[row, i, j]
    if step == 2:
        whiten(s.S, s.rows, 0)
        weigh(s, weight[row], information[row])
    else:
        widen(s.S, s.D, (0.5 * accel_mps2 * span_s**2) ** 2)
        motion_rows(span_s, s)
        whiten(s.S, s.rows, s.rows.shape[1])
        add_products(s.rows, s.products)


@inlined_part
def weigh(s: Scratch, weight: FloatArray, information: FloatArray) -> None:
    """The weight S⁻¹ = L⁻ᵀ L⁻¹ of a row, by the factor L in S, and the information Dᵀ S⁻¹ D.

    L⁻¹, lower triangular as L is, is put into `rows`.
    """
    for c in range(4):
        s.rows[c, c] = s.S[c, c]
        for i in range(c + 1, 4):
            total = 0.0
            for k in range(c, i):
                total -= s.S[i, k] * s.rows[k, c]
            s.rows[i, c] = total * s.S[i, i]
    for a in range(4):
        for b in range(a + 1):
            total = 0.0
            for i in range(a, 4):
                total += s.rows[i, a] * s.rows[i, b]
            weight[a, b] = weight[b, a] = total
    for a in range(3):
        for i in range(4):
            s.residual[i] = (
                weight[i, 0] * s.D[0, a] + weight[i, 1] * s.D[1, a]
                + weight[i, 2] * s.D[2, a] + weight[i, 3] * s.D[3, a]
            )  # fmt: skip
        for b in range(a + 1):
            total = s.residual[0] * s.D[0, b] + s.residual[1] * s.D[1, b]
            total += s.residual[2] * s.D[2, b] + s.residual[3] * s.D[3, b]
            information[a, b] = information[b, a] = total


_FOLDER = code_folder(Path(__file__))
points_to_look_at_compiled = compiled(points_to_look_at, _FOLDER)
moving_points_compiled = compiled(moving_points, _FOLDER)
