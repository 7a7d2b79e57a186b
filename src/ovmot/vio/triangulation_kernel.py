"""The compiled triangulation of features from the views of the window.

tests/vio/test_triangulation_kernel.py holds it against the plain NumPy
`geometry.triangulation.triangulate_many_views`.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import invert_symmetric


@part
def relative_pose(T_view_world: FloatArray, T_anchor_world: FloatArray, out: FloatArray) -> None:
    """out (3, 4): T_view_anchor of two views."""
    for a in range(3):
        out[a, 3] = T_view_world[a, 3]
        for b in range(3):
            out[a, b] = 0.0
            for c in range(3):
                out[a, b] += T_view_world[a, c] * T_anchor_world[b, c]
            out[a, 3] -= out[a, b] * T_anchor_world[b, 3]


@part
def _linear_depth(xy: FloatArray, T: FloatArray, n: int) -> float:
    """Depth of the least-squares point in the anchor, from (R_01 - x R_2) p = x t_2 - t_01."""
    N, inverse = np.zeros((3, 3)), np.empty((3, 3))
    c, a = np.zeros(3), np.empty(3)
    for v in range(n):
        for i in range(2):
            b = xy[v, i] * T[v, 2, 3] - T[v, i, 3]
            for k in range(3):
                a[k] = T[v, i, k] - xy[v, i] * T[v, 2, k]
            for k in range(3):
                c[k] += a[k] * b
                for m in range(k, 3):
                    N[k, m] += a[k] * a[m]
    small = 1e-9 * (N[0, 0] + N[1, 1] + N[2, 2])
    for k in range(3):
        N[k, k] += small
    invert_symmetric(N, inverse)
    depth: float = inverse[2, 0] * c[0] + inverse[2, 1] * c[1] + inverse[2, 2] * c[2]
    return depth


@part
def _system(
    point: FloatArray, xy: FloatArray, T: FloatArray, n: int, N: FloatArray, g: FloatArray
) -> float:
    """Squared error, upper normal matrix N (3, 3) and gradient g (3,) at (alpha, beta, rho)."""
    cost, J, h = 0.0, np.empty((2, 3)), np.empty(3)
    for i in range(3):
        g[i] = 0.0
        for j in range(3):
            N[i, j] = 0.0
    for v in range(n):
        V = T[v]
        for i in range(3):
            h[i] = V[i, 0] * point[0] + V[i, 1] * point[1] + V[i, 2] + V[i, 3] * point[2]
        if h[2] < 1e-6:  # behind the camera
            h[0], h[1], h[2] = 0.0, 0.0, 1.0
            cost += 1e3
        for a in range(2):
            place = h[a] / h[2]
            r = xy[v, a] - place
            cost += r * r
            for i in range(3):
                k = 3 if i == 2 else i
                J[a, i] = (V[a, k] - place * V[2, k]) / h[2]
                g[i] += J[a, i] * r
            for i in range(3):
                for j in range(i, 3):
                    N[i, j] += J[a, i] * J[a, j]
    return cost


@part
def _refine(
    point: FloatArray, xy: FloatArray, T: FloatArray, n: int, least_inverse: float
) -> float:
    """Levenberg-Marquardt on the point (alpha, beta, rho) in place; the squared error."""
    N, trial_N, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    g, trial_g, trial = np.empty(3), np.empty(3), np.empty(3)
    damping = 1e-4
    cost = _system(point, xy, T, n, N, g)
    for _ in range(6):
        for i in range(3):
            for j in range(i, 3):
                trial_N[i, j] = N[i, j]
            trial_N[i, i] *= 1.0 + damping
        invert_symmetric(trial_N, inverse)
        largest = 0.0
        for i in range(3):
            step = inverse[i, 0] * g[0] + inverse[i, 1] * g[1] + inverse[i, 2] * g[2]
            if not math.isfinite(step):
                step = 0.0
            trial[i] = point[i] + step
            largest = max(largest, abs(step))
        trial[2] = max(trial[2], least_inverse)
        trial_cost = _system(trial, xy, T, n, trial_N, trial_g)
        if trial_cost <= cost:
            cost, damping = trial_cost, max(0.1 * damping, 1e-9)
            for i in range(3):
                point[i], g[i] = trial[i], trial_g[i]
                for j in range(i, 3):
                    N[i, j] = trial_N[i, j]
        else:
            damping = min(10.0 * damping, 1e3)
        if largest < 1e-7:  # a step in normalized coordinates and 1/m
            break
    return cost


@part
def _seen_views(
    views: FloatArray, T: FloatArray, xy: FloatArray, relative: FloatArray
) -> tuple[int, int]:
    """Number of the views that saw the feature, and the first of them, the anchor.

    Their coordinates go to the first rows of `xy` (V, 2), their T_view_anchor to `relative`.
    """
    n, anchor = 0, 0
    for v in range(len(views)):
        if math.isfinite(views[v, 0]):
            if n == 0:
                anchor = v
            relative_pose(T[v], T[anchor], relative[n])
            xy[n, 0], xy[n, 1] = views[v, 0], views[v, 1]
            n += 1
    return n, anchor


@part
def _triangulate(
    views: FloatArray, T: FloatArray, sigma: float, depth_range: FloatArray, p: FloatArray
) -> bool:
    """Point p (3,) in world of one feature; is it valid?

    `views` (V, 2), NaN where unseen; `T` (V, 4, 4): the views' T_view_world.
    """
    xy, relative = np.empty(views.shape), np.empty((len(views), 3, 4))
    n, anchor = _seen_views(views, T, xy, relative)
    if n < 2:
        return False
    depth = _linear_depth(xy, relative, n)
    point = np.empty(3)
    point[0], point[1] = xy[0, 0], xy[0, 1]
    point[2] = 1.0 / (depth if depth > depth_range[0] else depth_range[0])
    cost = _refine(point, xy, relative, n, 1.0 / depth_range[2])
    depth = 1.0 / max(point[2], 1.0 / depth_range[2])
    point[2] = 1.0
    for i in range(3):
        p[i] = 0.0
        for k in range(3):
            p[i] += T[anchor, k, i] * (depth * point[k] - T[anchor, k, 3])
    in_range = depth_range[0] < depth < depth_range[1]
    return bool(in_range and cost / (2.0 * n) < (5.0 * sigma) ** 2)


def triangulate_views(
    views: FloatArray, T_view_world: FloatArray, sigma: float, depth_range: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Points (F, 3) in world, m, of features seen in V views, and which of them are valid (F,).

    `views` (F, V, 2): normalized coordinates, NaN where unseen; `T_view_world` (V, 4, 4); `sigma`:
    standard deviation of a normalized coordinate; `depth_range` (3,): least and greatest depth of a
    valid point, and the depth at infinity, m. See `geometry.triangulation.triangulate_many_views`;
    here each feature ends its own iteration.
    """
    p, valid = np.zeros((len(views), 3)), np.zeros(len(views), dtype=np.bool_)
    for f in range(len(views)):
        valid[f] = _triangulate(views[f], T_view_world, sigma, depth_range, p[f])
    return p, valid


_FOLDER = code_folder(Path(__file__))
triangulate_views_compiled = compiled(triangulate_views, _FOLDER)
