"""Compiled changes of a body's features: further ones in its map, in its state, and without some.

tests/objects/test_body_members_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.table_kernel import rows_of_ids
from ovmot.objects.body_kernel import BodyState
from ovmot.objects.body_step_kernel import (
    Body,
    FeatureMap,
    FrameViews,
    chosen,
    in_frame_of,
    turned_back,
    with_map,
    with_state_of,
)

_POSE = (0, 1, 2, 3, 10)  # p, ψ and β: what a feature's place hangs on at its birth


@part
def join_map(body: Body, frame: FrameViews, feature_id: IntArray, outline: bool) -> Body:
    """The body with further features (k,) of a frame, by their stereo places, in its map; its
    `outline` goes around them, or not."""
    m = body.map
    at = rows_of_ids(feature_id, frame.feature_id)
    held = rows_of_ids(feature_id, m.feature_id)
    joins = np.zeros(len(at), np.bool_)
    for k in range(len(at)):
        joins[k] = held[k] < 0 and at[k] >= 0 and math.isfinite(frame.p_world[at[k], 0])
    ids, at = feature_id[joins], at[joins]
    n = len(ids)
    f, C = np.empty((n, 3)), np.empty((n, 3, 3))
    for k in range(n):
        in_frame_of(
            body.state.x, body.state.P, frame.p_world[at[k]], frame.cov_world[at[k]], f[k], C[k]
        )
    grown = FeatureMap(
        np.concatenate((m.feature_id, ids)), np.concatenate((m.f, f)), np.concatenate((m.cov, C)),
        np.concatenate((m.n_seen, np.ones(n, np.int64))),
        np.concatenate((m.failures, np.zeros(n, np.int64))),
        np.concatenate((m.followed, np.ones(n, np.bool_))),
        np.concatenate((m.outline, np.full(n, outline))),
    )  # fmt: skip
    return with_map(body, grown)


@part
def leave_body(body: Body, feature_id: IntArray) -> Body:
    """The body without some features (k,), in its map and in its state."""
    kept = rows_of_ids(body.map.feature_id, feature_id) < 0
    in_state = rows_of_ids(body.feature_id, feature_id) < 0
    return with_state_of(with_map(body, chosen(body.map, kept)), in_state)


@part
def fill_state(body: Body, frame: FrameViews, most: int) -> Body:
    """The body with followed features of its map in the state, up to so many.

    Of more than there is room for every k-th: features are in the order in which they were found.
    """
    m, room = body.map, most - len(body.feature_id)
    held = rows_of_ids(m.feature_id, body.feature_id)
    at = rows_of_ids(m.feature_id, frame.feature_id)
    free, n = np.empty(len(at), np.int64), 0
    for k in range(len(at)):
        has_place = at[k] >= 0 and math.isfinite(frame.p_world[at[k], 0])
        if has_place and m.followed[k] and m.failures[k] == 0 and held[k] < 0:
            free[n] = k
            n += 1
    if room <= 0 or n == 0:
        return body
    some = free[:n][:: -(-n // room)].copy()
    return into_state(body, frame, m.feature_id[some], at[some])


@part
def into_state(body: Body, frame: FrameViews, ids: IntArray, at: IntArray) -> Body:
    """Delayed initialization of features (k,) at rows `at` (k,) of the frame, from its stereo pair:
    f = Rᵀ (X - p), less the matches' common error."""
    x, P = body.state.x, body.state.P
    n, k = len(P), len(ids)
    grown, f, J = np.empty((n + 3 * k, n + 3 * k)), np.empty((k, 3)), np.empty((3, 5))
    C, c, s = np.empty((3, 3)), math.cos(x[3]), math.sin(x[3])
    for a in range(n):
        for b in range(n):
            grown[a, b] = P[a, b]
    for i in range(k):
        place_by_pose(x, frame, at[i], f[i], J)
        first = n + 3 * i
        for a in range(3):
            for b in range(first):
                total = 0.0
                for j in range(5):
                    total += J[a, j] * grown[_POSE[j], b]
                grown[first + a, b] = grown[b, first + a] = total
        turned_back(frame.cov_world[at[i]], c, s, C)
        for a in range(3):
            for b in range(3):
                total = C[a, b]
                for j in range(5):
                    total += grown[first + a, _POSE[j]] * J[b, j]
                grown[first + a, first + b] = total
    last = np.empty((k, 2))
    for i in range(k):
        last[i, 0], last[i, 1] = frame.xy[at[i], 0], frame.xy[at[i], 1]
    return Body(
        body.timestamp_ns, BodyState(x, np.concatenate((body.state.f, f)), grown),
        np.concatenate((body.feature_id, ids)),
        np.concatenate((body.failures, np.zeros(k, np.int64))),
        np.concatenate((body.last_xy, last)), body.map, body.n_used,
    )  # fmt: skip


@part
def place_by_pose(x: FloatArray, frame: FrameViews, row: int, f: FloatArray, J: FloatArray) -> None:
    """The place f (3,) of a row of the frame in the body of state x (11,), and its derivative J
    (3, 5) by p, ψ and the matches' common error."""
    c, s, T = math.cos(x[3]), math.sin(x[3]), frame.T_world_cam0
    p = frame.p_world[row]
    rx, ry = p[0] - x[0], p[1] - x[1]
    vx, vy, vz = p[0] - T[0, 3], p[1] - T[1, 3], p[2] - T[2, 3]
    share = (vx * T[0, 2] + vy * T[1, 2] + vz * T[2, 2]) / frame.baseline
    f[0], f[1], f[2] = c * rx + s * ry, c * ry - s * rx, p[2] - x[2]
    J[:] = 0.0
    J[0, 0], J[0, 1], J[1, 0], J[1, 1], J[2, 2] = -c, -s, s, -c, -1.0
    J[0, 3], J[1, 3] = f[1], -f[0]
    J[0, 4], J[1, 4], J[2, 4] = -share * (c * vx + s * vy), -share * (c * vy - s * vx), -share * vz
    for a in range(3):
        f[a] += x[10] * J[a, 4]


def exchange_members(
    body: Body, frame: FrameViews, leaves: IntArray, joins: IntArray, outline: bool, most: int
) -> Body:
    """The body without and with some features of a frame, and with up to so many in its state."""
    if len(leaves) > 0:
        body = leave_body(body, leaves)
    if len(joins) > 0:
        body = join_map(body, frame, joins, outline)
    return fill_state(body, frame, most)


_FOLDER = code_folder(Path(__file__))
exchange_members_compiled = compiled(exchange_members, _FOLDER)
