"""The compiled views of found bodies: what the refinement adjusts, and where it starts from.

tests/objects/test_body_views_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import cross
from ovmot.kernels.stereo import transform
from ovmot.objects.rigid_kernel import Motions
from ovmot.segmentation.history_kernel import compose_motions

_SMALL_ANGLE, _SERIES_ANGLE = 1e-5, 1e-3  # series below them
_NEAR_PI = math.pi - 1e-4


class MovingViews(NamedTuple):
    """M points in L earlier frames and now, and where the left camera was.

    `then` (L, N, 4), `now` (N, 4), `span_s`, `n_frames` (L,): as `StereoHistory` has them, of all
    its N features; `point` (M,): those that may move, with positions `p_cam0` (M, 3) and their
    covariance `cov_cam0` (M, 3, 3). `T_world_imu` (K, 4, 4): the window's poses, newest last;
    `clone` (L,): those of the earlier frames.
    """

    then: FloatArray
    now: FloatArray
    span_s: FloatArray
    n_frames: IntArray
    point: IntArray
    p_cam0: FloatArray
    cov_cam0: FloatArray
    T_world_imu: FloatArray
    clone: IntArray
    T_imu_cam0: FloatArray


class BodyViews(NamedTuple):
    """B bodies with M points in V views, the last one now.

    `seen` (V, M, 4): normalized coordinates, NaN where unseen; all are seen now. `p_cam0` (M, 3):
    their positions now, `body` (M,): of each point. `T_world_cam0` (V, B, 4, 4), `span_s` (V, B):
    pose and age of each body's views. `track_length` (V, B): frames over which a point was tracked.
    `origin` (B, 3) in world: about which the body's `twist` (B, 6) is, where the refinement starts.
    """

    seen: FloatArray
    p_cam0: FloatArray
    body: IntArray
    T_world_cam0: FloatArray
    span_s: FloatArray
    track_length: FloatArray
    origin: FloatArray
    twist: FloatArray


def body_views(
    points: MovingViews, found: Motions, depth_gates: FloatArray
) -> tuple[BodyViews, BoolArray]:
    """Each body's points in three views: its earlier row, one half way if there is one, now.

    Also of which bodies (B,) the turn rate is observable, by the gates (dof + 1,) of the depths'
    scatter. The twists are those of the rigid motions.
    """
    n_bodies, n_points = len(found.size), len(found.point)
    out = BodyViews(
        np.empty((3, n_points, 4)), np.empty((n_points, 3)), np.empty(n_points, np.int64),
        np.empty((3, n_bodies, 4, 4)), np.zeros((3, n_bodies)), np.zeros((3, n_bodies)),
        np.empty((n_bodies, 3)), np.empty((n_bodies, 6)),
    )  # fmt: skip
    may_turn = np.empty(n_bodies, np.bool_)
    centre, start, last = np.empty(3), 0, len(points.T_world_imu) - 1
    for b in range(n_bodies):
        own = found.point[start : start + found.size[b]]
        row = found.velocity_row[b]
        between = row_between(points.span_s, row)
        for v in range(3):
            r = row if v == 0 else between
            pose = points.T_world_imu[last if v == 2 else points.clone[r]]
            compose_motions(pose, points.T_imu_cam0, out.T_world_cam0[v, b])
            if v < 2:
                out.span_s[v, b] = points.span_s[r]
                out.track_length[v, b] = points.n_frames[r]
        for k in range(len(own)):
            m, n = start + k, points.point[own[k]]
            out.body[m] = b
            for i in range(4):
                out.seen[0, m, i] = points.then[row, n, i]
                out.seen[1, m, i] = points.then[between, n, i] if between != row else np.nan
                out.seen[2, m, i] = points.now[n, i]
            for a in range(3):
                out.p_cam0[m, a] = points.p_cam0[own[k], a]
        may_turn[b] = has_depth(points.p_cam0, points.cov_cam0, own, depth_gates, centre)
        T_world_cam0 = out.T_world_cam0[2, b]
        transform(T_world_cam0, centre, out.origin[b])
        span_s = points.span_s[found.row[b]]
        twist_about(found.T_now_then[b], T_world_cam0, out.origin[b], span_s, out.twist[b])
        start += len(own)
    return out, may_turn


@part
def row_between(span_s: FloatArray, row: int) -> int:
    """The row nearest to half the span of `row`, among the younger ones; `row` if none is."""
    best, least = row, np.inf
    for r in range(len(span_s)):
        off = abs(span_s[r] - 0.5 * span_s[row])
        if span_s[r] < span_s[row] and off < least:
            best, least = r, off
    return best


@part
def has_depth(
    p_cam0: FloatArray, cov_cam0: FloatArray, own: IntArray, depth_gates: FloatArray,
    centre: FloatArray,
) -> bool:  # fmt: skip
    """Is a turn of a body's `own` points (n,) observable? Their `centre` (3,) is filled.

    In a turn, points at different depths move apart in the image: the depths must differ by more
    than their noise, by a chi-squared test.
    """
    n, noise, scatter = len(own), 0.0, 0.0
    for a in range(3):
        centre[a] = 0.0
    for k in own:
        noise += cov_cam0[k, 2, 2] / n
        for a in range(3):
            centre[a] += p_cam0[k, a] / n
    for k in own:
        scatter += (p_cam0[k, 2] - centre[2]) ** 2
    return bool(scatter > depth_gates[n - 1] * noise)


@part
def twist_about(
    T_now_then: FloatArray, T_world_cam0: FloatArray, origin: FloatArray, span_s: float,
    out: FloatArray,
) -> None:  # fmt: skip
    """Twist (6,), (ω, v), in world axes about an origin (3,), m, over a span.

    `T_now_then` (4, 4): motion in the left camera `T_world_cam0` (4, 4). The logarithm of
    `geometry.se3`; NaN for a rotation near half a turn, where its antisymmetric part vanishes.
    """
    T, M, R, t = T_world_cam0, np.empty((3, 4)), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(4):
            M[i, j] = T[i, 3] if j == 3 else 0.0
            for k in range(3):
                M[i, j] += T[i, k] * T_now_then[k, j]
    for i in range(3):
        for j in range(3):
            R[i, j] = M[i, 0] * T[j, 0] + M[i, 1] * T[j, 1] + M[i, 2] * T[j, 2]
    for i in range(3):
        t[i] = M[i, 3] - origin[i]
        for j in range(3):
            t[i] += R[i, j] * (origin[j] - T[j, 3])
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
        out[i] = w[i] / span_s
        out[3 + i] = (t[i] - 0.5 * once[i] + d * twice[i]) / span_s


body_views_compiled = compiled(body_views, code_folder(Path(__file__)))
