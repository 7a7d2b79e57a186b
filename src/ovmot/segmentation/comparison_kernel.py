"""The compiled comparison of stereo points then and now, point by point.

A point p_then, mapped by the ego motion into the present left camera, should be seen where the
present stereo pair sees it, if it is static. tests/segmentation/test_comparison_kernel.py holds the
plain NumPy twin.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part
from ovmot.kernels.small_matrices import add_products, invert_symmetric, whiten
from ovmot.kernels.stereo import project, secant, stereo_covariance, transform


class Pairs(NamedTuple):
    """Stereo pairs and positions of N points at L earlier frames and now, as `StereoHistory`.

    `then` (L, N, 4), `p_then` (L, N, 3), `now` (N, 4), `p_now` (N, 3).
    """

    then: FloatArray
    p_then: FloatArray
    now: FloatArray
    p_now: FloatArray


class EgoMotion(NamedTuple):
    """`T_now_then` (L, 4, 4) of the left camera since L earlier frames, `span_s` (L,) ago.

    `covariance` (L, 6, 6) of (φ, τ), by which the ego motion's error moves a predicted point p as
    [p]x φ + τ.
    """

    T_now_then: FloatArray
    covariance: FloatArray
    span_s: FloatArray


class StereoNoise(NamedTuple):
    """The stereo extrinsics, and the standard deviations of what is seen, in normalized units.

    `sigma` (4,): of the pixels, `drift` (L,): of a patch tracked since the earlier frames;
    `drift_per_flow`: share of its way in the left image.
    """

    T_cam1_cam0: FloatArray
    sigma: FloatArray
    drift: FloatArray
    drift_per_flow: float


class Scratch(NamedTuple):
    """Memory of one comparison.

    `predicted` (3,) point and its covariance `C` (3, 3), `h` (4,) where it is seen, `J` (4, 3) by
    the point, `D` (4, 3): residual = D (position now - predicted). The rest are steps on the way.
    """

    predicted: FloatArray
    C: FloatArray
    h: FloatArray
    J: FloatArray
    D: FloatArray
    C_then: FloatArray
    RC: FloatArray
    BE: FloatArray
    S: FloatArray
    residual: FloatArray
    rows: FloatArray
    products: FloatArray
    information: FloatArray


class Rest(NamedTuple):
    """N points against rest: see `Evidence`; `cost` (N,) of the velocity, `predicted` (N, 3)."""

    distance: FloatArray
    rows: IntArray
    velocity: FloatArray
    covariance: FloatArray
    cost: FloatArray
    in_last: BoolArray
    predicted: FloatArray
    distance_m: FloatArray
    reprojection: FloatArray


@inlined_part
def new_scratch() -> Scratch:
    """Memory of one comparison, not yet filled."""
    return Scratch(
        np.empty(3), np.empty((3, 3)), np.empty(4), np.empty((4, 3)), np.empty((4, 3)),
        np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 6)), np.empty((4, 4)), np.empty(4),
        np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 3)),
    )  # fmt: skip


def compare_with_rest(
    pairs: Pairs,
    ego: EgoMotion,
    noise: StereoNoise,
    max_range: float,
    forgiven_mps: float,
    accel_mps2: float,
    fit_beyond: float,
    depth_weight: float,
    focal: FloatArray,
) -> Rest:
    """How far each of N points is from rest over L earlier frames, and how it moves.

    Under rest the residual r ~ N(0, S + J Jᵀ (s Δt)²) with `forgiven_mps` s; compared are points
    within `max_range` metres now and predicted. Squared distances that the pixels' noise alone
    keeps below `fit_beyond` are not computed, but taken as 0. Points of `fit_beyond` and more get a
    velocity: r = D v Δt by weighted least squares, changes of it by `accel_mps2` forgiven. Over the
    last interval: distance in metres, its depth weighted, and the reprojection error in pixels by
    the focal lengths (4,).
    """
    n_rows, n_points = pairs.then.shape[:2]
    out, s = no_comparison(n_points), new_scratch()
    for n in range(n_points):
        if not pairs.p_now[n, 2] < max_range:
            continue
        for fit in range(2):  # first the distance from rest; a velocity only where that is large
            if fit == 1 and (out.rows[n] == 0 or out.distance[n] < fit_beyond):
                break
            s.products[:, :] = 0.0
            for row in range(n_rows):
                if not predict_point(pairs, ego, row, n, s):
                    continue
                if row == n_rows - 1 and fit == 0:
                    last_interval(pairs, noise, n, depth_weight, focal, s, out)
                if not s.predicted[2] < max_range:
                    continue
                if fit == 0 and is_within_noise(pairs, noise, row, n, fit_beyond, s):
                    out.rows[n] += 1
                    out.in_last[n] = row == n_rows - 1
                    continue
                spread_point(pairs, ego, noise, row, n, s)
                image_covariance(pairs, noise, row, n, s.J, s.C, s.S)
                span = ego.span_s[row]
                shift = 0.5 * accel_mps2 * span**2 if fit == 1 else forgiven_mps * span
                widen(s.S, s.J, shift**2)
                motion_rows(span, s)
                whiten(s.S, s.rows, s.rows.shape[1] if fit == 1 else 1)
                if fit == 1:
                    add_products(s.rows, s.products)
                else:
                    add_distance(row, n, n_rows, s, out)
        if out.rows[n] > 0 and out.distance[n] >= fit_beyond:
            out.cost[n] = fit_velocity(s, out.velocity[n], out.covariance[n])
    return out


@inlined_part
def no_comparison(n_points: int) -> Rest:
    """That of points without earlier ones."""
    return Rest(
        np.zeros(n_points), np.zeros(n_points, np.int64), np.full((n_points, 3), np.nan),
        np.full((n_points, 3, 3), np.nan), np.full(n_points, np.nan),
        np.zeros(n_points, np.bool_), np.full((n_points, 3), np.nan), np.full(n_points, np.nan),
        np.full(n_points, np.nan),
    )  # fmt: skip


@inlined_part
def predict_point(pairs: Pairs, ego: EgoMotion, row: int, n: int, s: Scratch) -> bool:
    """Where point n of an earlier row is now, if it is static; False where that is nowhere."""
    transform(ego.T_now_then[row], pairs.p_then[row, n], s.predicted)
    return bool(s.predicted[2] > 0.1)  # metres


@inlined_part
def drift_variance(pairs: Pairs, noise: StereoNoise, row: int, n: int) -> float:
    """Of a patch's place in normalized coordinates, since an earlier row."""
    du, dv = pairs.now[n, 0] - pairs.then[row, n, 0], pairs.now[n, 1] - pairs.then[row, n, 1]
    return float(noise.drift[row] ** 2 + noise.drift_per_flow**2 * (du * du + dv * dv))


@inlined_part
def is_within_noise(
    pairs: Pairs, noise: StereoNoise, row: int, n: int, bound: float, s: Scratch
) -> bool:
    """Is the residual's squared distance below a bound already by the noise of the pixels now?

    What else is unsure only makes it less.
    """
    T, p, now = noise.T_cam1_cam0, s.predicted, pairs.now[n]
    drifted, distance = drift_variance(pairs, noise, row, n), 0.0
    transform(T, p, s.h)
    for i in range(4):
        seen_at = p[i] / p[2] if i < 2 else s.h[i - 2] / s.h[2]
        distance += (now[i] - seen_at) ** 2 / (noise.sigma[i] ** 2 + drifted)
    return bool(distance < bound)


@inlined_part
def spread_point(
    pairs: Pairs, ego: EgoMotion, noise: StereoNoise, row: int, n: int, s: Scratch
) -> None:
    """Covariance of the predicted point, C = R C_then Rᵀ + B ego Bᵀ with B = ([p]x, I).

    Also its views with their derivative, the residual, and the secant to where it is seen now.
    """
    T10, T, E, p = noise.T_cam1_cam0, ego.T_now_then[row], ego.covariance[row], s.predicted
    stereo_covariance(pairs.p_then[row, n], T10, noise.sigma, s.C_then)
    project(p, T10, s.h, s.J)
    secant(p, pairs.p_now[n], T10, s.D)
    for i in range(4):
        s.residual[i] = pairs.now[n, i] - s.h[i]
    for k in range(6):
        s.BE[0, k] = E[3, k] - p[2] * E[1, k] + p[1] * E[2, k]
        s.BE[1, k] = E[4, k] + p[2] * E[0, k] - p[0] * E[2, k]
        s.BE[2, k] = E[5, k] - p[1] * E[0, k] + p[0] * E[1, k]
    C, RC, BE = s.C_then, s.RC, s.BE
    for a in range(3):
        for k in range(3):
            RC[a, k] = T[a, 0] * C[0, k] + T[a, 1] * C[1, k] + T[a, 2] * C[2, k]
        s.C[a, 0] = BE[a, 3] - BE[a, 1] * p[2] + BE[a, 2] * p[1]
        s.C[a, 1] = BE[a, 4] + BE[a, 0] * p[2] - BE[a, 2] * p[0]
        s.C[a, 2] = BE[a, 5] - BE[a, 0] * p[1] + BE[a, 1] * p[0]
        for b in range(3):
            s.C[a, b] += RC[a, 0] * T[b, 0] + RC[a, 1] * T[b, 1] + RC[a, 2] * T[b, 2]


@inlined_part
def image_covariance(
    pairs: Pairs, noise: StereoNoise, row: int, n: int, J: FloatArray, C: FloatArray, S: FloatArray
) -> None:
    """S (4, 4) = J C Jᵀ + pixel noise + drift of the patch since the row, the lower triangle."""
    drifted = drift_variance(pairs, noise, row, n)
    for i in range(4):
        x = J[i, 0] * C[0, 0] + J[i, 1] * C[1, 0] + J[i, 2] * C[2, 0]
        y = J[i, 0] * C[0, 1] + J[i, 1] * C[1, 1] + J[i, 2] * C[2, 1]
        z = J[i, 0] * C[0, 2] + J[i, 1] * C[1, 2] + J[i, 2] * C[2, 2]
        for j in range(i + 1):
            S[i, j] = x * J[j, 0] + y * J[j, 1] + z * J[j, 2]
        S[i, i] += noise.sigma[i] ** 2 + drifted


@inlined_part
def widen(S: FloatArray, J: FloatArray, variance: float) -> None:
    """Add J Jᵀ times a variance to S (4, 4), the lower triangle."""
    for i in range(4):
        for j in range(i + 1):
            S[i, j] += variance * (J[i, 0] * J[j, 0] + J[i, 1] * J[j, 1] + J[i, 2] * J[j, 2])


@inlined_part
def motion_rows(span_s: float, s: Scratch) -> None:
    """The rows (4, 4) of r = D v Δt: r, then D Δt."""
    for i in range(4):
        s.rows[i, 0] = s.residual[i]
        for k in range(3):
            s.rows[i, 1 + k] = s.D[i, k] * span_s


@inlined_part
def add_distance(row: int, n: int, n_rows: int, s: Scratch, out: Rest) -> None:
    """The squared Mahalanobis distance of a residual that is white now, if it is finite."""
    d = s.rows[0, 0] ** 2 + s.rows[1, 0] ** 2 + s.rows[2, 0] ** 2 + s.rows[3, 0] ** 2
    if math.isfinite(d):
        out.distance[n] = max(out.distance[n], d)
        out.rows[n] += 1
        out.in_last[n] = row == n_rows - 1


@inlined_part
def fit_velocity(s: Scratch, velocity: FloatArray, covariance: FloatArray) -> float:
    """Velocity (3,), its covariance (3, 3) and the cost, by the summed normal equations."""
    for a in range(3):
        for b in range(3):
            s.information[a, b] = s.products[1 + a, 1 + b] + (1e-6 if a == b else 0.0)
    invert_symmetric(s.information, covariance)
    cost = s.products[0, 0]
    for a in range(3):
        velocity[a] = 0.0
        for b in range(3):
            velocity[a] += covariance[a, b] * s.products[0, 1 + b]
    for a in range(3):
        cost -= 2.0 * velocity[a] * s.products[0, 1 + a]
        for b in range(3):
            cost += velocity[a] * s.products[1 + a, 1 + b] * velocity[b]
    return float(cost)


@inlined_part
def last_interval(
    pairs: Pairs, noise: StereoNoise, n: int, depth_weight: float, focal: FloatArray, s: Scratch,
    out: Rest,
) -> None:  # fmt: skip
    """The predicted point n, its distance in metres and its reprojection error, the worse view's.

    The reprojection error is measured in the undistorted normalized plane.
    """
    p, now = s.predicted, pairs.p_now[n]
    project(p, noise.T_cam1_cam0, s.h, s.J)
    squared = (now[0] - p[0]) ** 2 + (now[1] - p[1]) ** 2
    out.distance_m[n] = math.sqrt(squared + (depth_weight * (now[2] - p[2])) ** 2)
    for k in range(3):
        out.predicted[n, k] = p[k]
    for i in range(4):
        s.h[i] = (pairs.now[n, i] - s.h[i]) * focal[i]
    out.reprojection[n] = max(math.hypot(s.h[0], s.h[1]), math.hypot(s.h[2], s.h[3]))


compare_with_rest_compiled = compiled(compare_with_rest, code_folder(Path(__file__)))
