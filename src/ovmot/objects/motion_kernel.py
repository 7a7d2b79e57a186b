"""The compiled search for points that may move: which to look at, and how each of them moves.

tests/objects/test_motion_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part
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
    `predicted` (L, M, 3), `weight` (L, M, 4, 4), `information` (L, M, 3, 3): as `MotionHistory`.
    """

    point: IntArray
    velocity: FloatArray
    velocity_cov: FloatArray
    predicted: FloatArray
    weight: FloatArray
    information: FloatArray


def points_to_look_at(
    pairs: Pairs,
    cov_now: FloatArray,
    T_now_then: FloatArray,
    seems_static: BoolArray,
    max_range: float,
    hint: float,
) -> tuple[IntArray, IntArray]:
    """Points (C,) within range that do not seem static, or are beyond `hint` from rest.

    Also in how many earlier frames each was seen, (C,); in one at least. The squared distance is
    roughly that of Mahalanobis since the oldest frame: axes apart and with the present covariance
    for both times, quick, to spare most points the full comparison.
    """
    n_rows, n_points = pairs.p_then.shape[:2]
    index, known = np.empty(n_points, np.int64), np.empty(n_points, np.int64)
    count, q = 0, np.empty(3)
    for n in range(n_points):
        if not pairs.p_now[n, 2] < max_range:
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
        if rows > 0 and (distance > hint or not seems_static[n]):
            index[count], known[count] = n, rows
            count += 1
    return index[:count], known[:count]


def moving_points(
    pairs: Pairs,
    ego: EgoMotion,
    noise: StereoNoise,
    candidate: IntArray,
    has_track: BoolArray,
    n_old: int,
    accel_mps2: float,
    bound: FloatArray,
    moves: float,
) -> MovingPoints:
    """Those of the candidates (C,) that one velocity explains, and that are not static by it.

    The cost of the velocity is below `bound` (L + 1,), by the number of rows, and its squared
    Mahalanobis distance from rest above `moves`. Points of tracks, `has_track` (C,), may move by
    their last rows alone, without the `n_old` first ones: a car that brakes was faster before.
    """
    n_rows, n = len(ego.span_s), len(candidate)
    out = MovingPoints(
        np.empty(n, np.int64), np.empty((n, 3)), np.empty((n, 3, 3)),
        np.full((n_rows, n, 3), np.nan), np.zeros((n_rows, n, 4, 4)), np.zeros((n_rows, n, 3, 3)),
    )  # fmt: skip
    count, s, J_now = 0, new_scratch(), np.empty((4, 3))
    for k in range(n):
        point, v, C = candidate[k], out.velocity[count], out.velocity_cov[count]
        project(pairs.p_now[point], noise.T_cam1_cam0, s.h, J_now)
        first, steady = 0, False
        for step in range(3):  # all rows; the last ones; the weights of those that were used
            if step == 1:
                if steady or not has_track[k]:
                    continue
                first = n_old
            if step == 2 and not (steady and squared_mahalanobis(v, C) > moves):
                break
            rows = add_rows(pairs, ego, noise, point, first, J_now, accel_mps2, step, count, s, out)
            if step < 2:
                steady = fit_velocity(s, v, C) < bound[rows]
            else:
                out.point[count] = point
                count += 1
    return MovingPoints(
        out.point[:count], out.velocity[:count], out.velocity_cov[:count],
        out.predicted[:, :count].copy(), out.weight[:, :count].copy(),
        out.information[:, :count].copy(),
    )  # fmt: skip


@inlined_part
def add_rows(
    pairs: Pairs, ego: EgoMotion, noise: StereoNoise, point: int, first: int, J_now: FloatArray,
    accel_mps2: float, step: int, place: int, s: Scratch, out: MovingPoints,
) -> int:  # fmt: skip
    """The rows from the `first` one on that exist, their normal equations added up in `products`.

    In the last step the predictions and weights are put in their `place`.
    """
    rows = 0
    s.products[:, :] = 0.0
    for row in range(len(ego.span_s)):
        if not predict_point(pairs, ego, row, point, s):
            continue
        if step == 2:
            for a in range(3):
                out.predicted[row, place, a] = s.predicted[a]
        if row < first:
            continue
        rows += 1
        spread_point(pairs, ego, noise, row, point, s)
        image_covariance(pairs, noise, row, point, J_now, s.C, s.S)
        if step == 2:
            identity_rows(s)
        else:
            widen(s.S, s.D, (0.5 * accel_mps2 * ego.span_s[row] ** 2) ** 2)
            motion_rows(ego.span_s[row], s)
        whiten(s.S, s.rows, 0)
        add_products(s.rows, s.products)
        if step == 2:
            weigh(row, place, s, out)
    return rows


@inlined_part
def identity_rows(s: Scratch) -> None:
    """The rows (4, 4) that whitening turns into L⁻¹."""
    for i in range(4):
        for j in range(4):
            s.rows[i, j] = 1.0 if i == j else 0.0


@inlined_part
def weigh(row: int, k: int, s: Scratch, out: MovingPoints) -> None:
    """The weight S⁻¹, which is in `products`, and the information Dᵀ S⁻¹ D of point k.

    `products` is zero again.
    """
    weight, information, D = out.weight[row, k], out.information[row, k], s.D
    for i in range(4):
        for j in range(4):
            weight[i, j] = s.products[i, j]
            s.products[i, j] = 0.0
    for i in range(4):
        for a in range(3):
            WD = (
                weight[i, 0] * D[0, a] + weight[i, 1] * D[1, a]
                + weight[i, 2] * D[2, a] + weight[i, 3] * D[3, a]
            )  # fmt: skip
            for b in range(3):
                information[a, b] += WD * D[i, b]


_FOLDER = code_folder(Path(__file__))
points_to_look_at_compiled = compiled(points_to_look_at, _FOLDER)
moving_points_compiled = compiled(moving_points, _FOLDER)
