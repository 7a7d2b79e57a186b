"""The normal equations of the refinement, with the points eliminated, as kernels call them.

tests/objects/test_refinement_kernel.py holds its plain NumPy twin.
"""

import math
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import inlined_part, part
from ovmot.kernels.small_matrices import cross, invert_symmetric, solve_positive

_ITERATIONS = 6  # of Gauss-Newton, at most
_WIDE_ITERATIONS = 2  # the first ones, with a wider bound for outliers
_SMALL_STEP = 0.02  # squared sigmas: a step that ends the iterations


class WeightedViews(NamedTuple):
    """Stereo pairs of M points of B bodies in V views, the last one now, with their weights.

    `seen` (V, M, 4): normalized coordinates; `by_difference`, `by_sum` (V, M): inverse standard
    deviations, 1/px, of the difference and the sum of both cameras, 0 where unseen. `body` (M,): of
    each point; `span_s` (V, B). `into_view` (V, B, 4, 4): from world axes about each body's origin
    into its views, `out_of_now` (B, 4, 4) out of the present one. `focal` (4,): focal lengths,
    pixels.
    """

    seen: FloatArray
    by_difference: FloatArray
    by_sum: FloatArray
    body: IntArray
    span_s: FloatArray
    into_view: FloatArray
    out_of_now: FloatArray
    T_cam1_cam0: FloatArray
    focal: FloatArray


class Refined(NamedTuple):
    """M points (M, 3) (x, y, 1/z) of the present left camera and B twists (B, 6), refined.

    `information` (B, 6, 6) of the twists, prior included; `cost`, `weight`, `inlier` (M,),
    `N_inverse` (M, 3, 3) and `K` (M, 6, 3) as in `Reduced`, at the last step.
    """

    point: FloatArray
    twist: FloatArray
    information: FloatArray
    cost: FloatArray
    weight: FloatArray
    inlier: BoolArray
    N_inverse: FloatArray
    K: FloatArray


class Reduced(NamedTuple):
    """Normal equations of B bodies, and per point (M,) what was eliminated.

    `information` (B, 6, 6), `gradient` (B, 6) of the twists. `cost` (M,): sum of the squared
    residuals at the best point, `weight` (M,): of the robust loss, zero for outliers. `N_inverse`
    (M, 3, 3), `step` (M, 3): a point's covariance and its step for the given twist; `K` (M, 6, 3):
    the step changes by -Kᵀ δ as the twist changes by δ.
    """

    information: FloatArray
    gradient: FloatArray
    cost: FloatArray
    weight: FloatArray
    inlier: BoolArray
    N_inverse: FloatArray
    step: FloatArray
    K: FloatArray


@part
def refine(
    point: FloatArray,
    twist: FloatArray,
    s: WeightedViews,
    huber: FloatArray,
    bound: FloatArray,
    prior: FloatArray,
) -> Refined:
    """Gauss-Newton from points (M, 3) (x, y, 1/z) and twists (B, 6).

    `huber`, `bound` (M,) as in `reduce_points`; `prior` (B, 6): information of twists of zero.
    """
    point, twist, step = point.copy(), twist.copy(), np.empty(6)
    n_bodies, A = len(twist), np.empty((6, 6))
    for iteration in range(_ITERATIONS):
        # a point far off now may fit a better motion: the bound is wide at first
        wide = iteration < _WIDE_ITERATIONS
        reduced, largest = reduce_points(point, twist, s, huber, bound, 9.0 if wide else 1.0), 0.0
        for b in range(n_bodies):
            for a in range(6):
                reduced.gradient[b, a] -= prior[b, a] * twist[b, a]
                reduced.information[b, a, a] += prior[b, a] + 1e-6
                step[a] = reduced.gradient[b, a]
                for c in range(6):
                    A[a, c] = reduced.information[b, a, c]
            solve_positive(A, step)
            squared = 0.0  # δᵀ N δ with N δ = g
            for a in range(6):
                twist[b, a] += step[a]
                squared += step[a] * reduced.gradient[b, a]
            largest = max(largest, squared)
            step_points(point, step, b, s.body, reduced)
        if not wide and largest < _SMALL_STEP:
            break
    return Refined(
        point, twist, reduced.information, reduced.cost, reduced.weight, reduced.inlier,
        reduced.N_inverse, reduced.K,
    )  # fmt: skip


@part
def step_points(
    point: FloatArray, twist_step: FloatArray, b: int, body: IntArray, reduced: Reduced
) -> None:
    """Move the points of body b after a step (6,) of its twist.

    No point goes behind the camera: an inverse depth is at most halved or doubled.
    """
    for n in range(len(point)):
        if body[n] != b:
            continue
        for c in range(3):
            step = reduced.step[n, c]
            for a in range(6):
                step -= twist_step[a] * reduced.K[n, a, c]
            if c == 2:
                step = min(max(step, -0.5 * point[n, 2]), point[n, 2])
            point[n, c] += step


@part
def reduce_points(
    point: FloatArray, twist: FloatArray, s: WeightedViews, huber: FloatArray, bound: FloatArray,
    wider: float,
) -> Reduced:  # fmt: skip
    """The normal equations at points (M, 3) (x, y, 1/z) and twists (B, 6), points eliminated.

    `huber` (M,): root of the cost up to which a point's loss is quadratic; `bound` (M,): cost from
    which it is an outlier, times `wider`.
    """
    n_bodies, n_points, n_views = len(twist), len(point), len(s.seen)
    out = Reduced(
        np.zeros((n_bodies, 6, 6)), np.zeros((n_bodies, 6)), np.empty(n_points),
        np.zeros(n_points), np.zeros(n_points, dtype=np.bool_), np.empty((n_points, 3, 3)),
        np.empty((n_points, 3)), np.empty((n_points, 6, 3)),
    )  # fmt: skip
    C, J = np.empty((n_views, n_bodies, 3, 4)), np.empty((n_views, n_bodies, 6, 3))
    for v in range(n_views):
        for b in range(n_bodies):
            through_body(s.span_s[v, b] * twist[b], s.into_view[v, b], C[v, b], J[v, b])
    rows, products, G = np.empty((4, 10)), np.empty((10, 10)), np.empty((3, 10))
    for n in range(n_points):
        b = s.body[n]
        products.fill(0.0)
        for v in range(n_views):
            if s.by_sum[v, n] > 0.0:
                view_rows(point[n], C[v, b], J[v, b], s.span_s[v, b], v, n, s, G, rows)
                add_row_products(rows, s.span_s[v, b] > 0.0, products)
        eliminate(products, n, out)
        out.inlier[n] = out.cost[n] < wider * bound[n]
        if out.inlier[n]:
            out.weight[n] = min(1.0, huber[n] / math.sqrt(max(out.cost[n], 1e-12)))
            add_reduced(products, n, b, out)
    return out


@inlined_part
def add_row_products(rows: FloatArray, moving: bool, products: FloatArray) -> None:
    """Add rowsᵀ rows (10, 10), the upper triangle; the twist's part only where there is one."""
    for i in range(4):
        for a in range(10):
            if moving or not 3 <= a < 9:
                for c in range(a, 10):
                    products[a, c] += rows[i, a] * rows[i, c]


@inlined_part
def eliminate(products: FloatArray, n: int, out: Reduced) -> None:
    """Eliminate point n, from the products of derivatives by point (3), twist (6), residual."""
    invert_symmetric(products, out.N_inverse[n])
    cost = products[9, 9]
    for a in range(3):
        out.step[n, a] = 0.0
        for c in range(3):
            out.step[n, a] += out.N_inverse[n, a, c] * products[c, 9]
        cost -= out.step[n, a] * products[a, 9]
    out.cost[n] = cost
    for a in range(6):
        for c in range(3):
            out.K[n, a, c] = 0.0
            for d in range(3):
                out.K[n, a, c] += products[d, 3 + a] * out.N_inverse[n, d, c]


@inlined_part
def add_reduced(products: FloatArray, n: int, b: int, out: Reduced) -> None:
    """Add the Schur complement of point n to the twist's equations of body b, by its weight."""
    for a in range(6):
        for c in range(7):  # the last one is the gradient
            term = products[3 + a, 3 + c] if a <= c else products[3 + c, 3 + a]
            for d in range(3):
                term -= out.K[n, a, d] * products[d, 3 + c]
            if c < 6:
                out.information[b, a, c] += out.weight[n] * term
            else:
                out.gradient[b, a] += out.weight[n] * term


@part
def through_body(xi: FloatArray, into_view: FloatArray, C: FloatArray, J: FloatArray) -> None:
    """C (3, 4) = into_view exp(-ξ), and the left Jacobian of ξ = (ω, v) = s (ω', v') as J (6, 3).

    J holds the blocks J and Q of [[J, 0], [Q, J]] = Σ ad(ξ)ⁿ / (n + 1)!, and exp(ω) = I + [ω]x J
    (J. Solà et al., arXiv:1812.01537, sec. II-G), so that exp(-s (ξ' + δ)) = exp(-ξ) exp(-s J_l δ).
    """
    w, u = (xi[0], xi[1], xi[2]), (xi[3], xi[4], xi[5])
    for k in range(3):
        A, B = (1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2)), (0.0, 0.0, 0.0)
        for a in range(3):
            J[a, k], J[3 + a, k] = A[a], 0.0
        for n in range(2, 60):
            by_w, by_u, A = cross(w, B), cross(u, A), cross(w, A)
            A = (A[0] / n, A[1] / n, A[2] / n)
            B = ((by_w[0] + by_u[0]) / n, (by_w[1] + by_u[1]) / n, (by_w[2] + by_u[2]) / n)
            largest = 0.0
            for a in range(3):
                J[a, k] += A[a]
                J[3 + a, k] += B[a]
                largest = max(largest, abs(A[a]), abs(B[a]))
            if largest < 1e-17:
                break
    back = np.empty((3, 4))  # exp(-ξ)
    for k in range(3):
        column = cross(w, (J[0, k], J[1, k], J[2, k]))
        for a in range(3):
            back[k, a] = column[a] + (1.0 if a == k else 0.0)
    for a in range(3):
        back[a, 3] = 0.0
        for k in range(3):
            back[a, 3] -= back[a, k] * (J[k, 0] * u[0] + J[k, 1] * u[1] + J[k, 2] * u[2])
    for a in range(3):
        for c in range(4):
            C[a, c] = into_view[a, 3] if c == 3 else 0.0
            for k in range(3):
                C[a, c] += into_view[a, k] * back[k, c]


@inlined_part
def view_rows(
    point: FloatArray, C: FloatArray, J: FloatArray, span: float, v: int, n: int, s: WeightedViews,
    G: FloatArray, rows: FloatArray,
) -> None:  # fmt: skip
    """Rows (4, 10) of one view: derivatives by point (3) and twist (6), and the residual.

    The point in the view is q = C D + ρ c, with D = R ray + ρ t about the origin. A motion
    exp(τ) of D gives C [-[D]x, ρ I] τ, with τ = -s [[J, 0], [Q, J]] δ. G (3, 10) is filled with the
    derivatives of q and q itself.
    """
    out, x, y, rho = s.out_of_now[s.body[n]], point[0], point[1], point[2]
    D = (
        out[0, 0] * x + out[0, 1] * y + out[0, 2] + rho * out[0, 3],
        out[1, 0] * x + out[1, 1] * y + out[1, 2] + rho * out[1, 3],
        out[2, 0] * x + out[2, 1] * y + out[2, 2] + rho * out[2, 3],
    )
    for a in range(3):
        G[a, 9] = C[a, 0] * D[0] + C[a, 1] * D[1] + C[a, 2] * D[2] + rho * C[a, 3]
        for c in range(3):
            column = c if c < 2 else 3
            G[a, c] = C[a, 0] * out[0, column] + C[a, 1] * out[1, column] + C[a, 2] * out[2, column]
        G[a, 2] += C[a, 3]
        # C [D]x, row by row: (C row) x D
        turn = cross((C[a, 0], C[a, 1], C[a, 2]), D)
        for c in range(3):
            by_turn, by_shift, by_both = 0.0, 0.0, 0.0
            for k in range(3):
                by_turn += turn[k] * J[k, c]
                by_shift += C[a, k] * J[k, c]
                by_both += C[a, k] * J[3 + k, c]
            G[a, 3 + c] = span * (by_turn - rho * by_both)
            G[a, 6 + c] = -span * rho * by_shift
    T, f, minus, plus = s.T_cam1_cam0, s.focal, s.by_difference[v, n], s.by_sum[v, n]
    z0 = G[2, 9]
    z1 = T[2, 0] * G[0, 9] + T[2, 1] * G[1, 9] + T[2, 2] * z0 + rho * T[2, 3]
    for i in range(2):
        x1 = T[i, 0] * G[0, 9] + T[i, 1] * G[1, 9] + T[i, 2] * z0 + rho * T[i, 3]
        h0, h1 = G[i, 9] / z0, x1 / z1
        for c in range(10):
            if c == 9:
                left, right = s.seen[v, n, i] - h0, s.seen[v, n, 2 + i] - h1
            else:
                along = T[i, 0] * G[0, c] + T[i, 1] * G[1, c] + T[i, 2] * G[2, c]
                depth = T[2, 0] * G[0, c] + T[2, 1] * G[1, c] + T[2, 2] * G[2, c]
                if c == 2:
                    along, depth = along + T[i, 3], depth + T[2, 3]
                left, right = (G[i, c] - h0 * G[2, c]) / z0, (along - h1 * depth) / z1
            left, right = left * f[i], right * f[2 + i]
            rows[i, c] = (left - right) * minus
            rows[2 + i, c] = (left + right) * plus
