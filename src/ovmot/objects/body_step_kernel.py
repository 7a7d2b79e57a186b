"""The compiled step of one body: its state and the map of its features, brought up to a frame.

tests/objects/test_body_step_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.kernels.small_matrices import invert_symmetric
from ovmot.kernels.table_kernel import rows_of_ids
from ovmot.objects.body_kernel import (
    LEFT,
    N_BODY,
    REFUSED,
    STEREO,
    UNSEEN,
    BodyState,
    EgoStep,
    Gates,
    Manoeuvres,
    StereoView,
    predict_body,
    update_body,
)


class FeatureMap(NamedTuple):
    """All features ever seen of a body: ids (m,), places (m, 3) in its frame with covariance
    (m, 3, 3), how often each was seen and how often in a row it did not fit (m,), whether it is
    still followed and whether the body's outline goes around it (m,)."""

    feature_id: IntArray
    f: FloatArray
    cov: FloatArray
    n_seen: IntArray
    failures: IntArray
    followed: BoolArray
    outline: BoolArray


class Body(NamedTuple):
    """A body at one time: its state, the ids (n,) of the features in it, how often in a row each
    did not fit, where each was last (n, 2), normalized, its map, and how many features were used in
    the last update."""

    timestamp_ns: int
    state: BodyState
    feature_id: IntArray
    failures: IntArray
    last_xy: FloatArray
    map: FeatureMap
    n_used: int

    @property
    def velocity(self) -> FloatArray:
        """Of the body's frame (3,) in world, m/s."""
        return self.state.x[4:7]

    @property
    def members(self) -> IntArray:
        """Ids (k,) of the features that are followed, rising."""
        return np.sort(self.map.feature_id[self.map.followed])


class FrameViews(NamedTuple):
    """N features of one frame.

    `xy` (N, 4): normalized, NaN where unseen; `p_world` (N, 3): places by this stereo pair alone
    with covariance (N, 3, 3), NaN without one. `variance` (4,): of the normalized coordinates;
    `drift_variance`: rad², of a patch since the frame before; `drift_per_flow`: of its way, a
    standard deviation. `step`: the rig's since then; `correction` (4, 4): of the world since the
    last frame was processed.
    """

    timestamp_ns: int
    feature_id: IntArray
    xy: FloatArray
    p_world: FloatArray
    cov_world: FloatArray
    T_world_cam0: FloatArray
    T_cam0_world: FloatArray
    T_cam1_cam0: FloatArray
    variance: FloatArray
    focal: float
    baseline: float
    drift_variance: float
    drift_per_flow: float
    step: EgoStep
    correction: FloatArray


class Rules(NamedTuple):
    """What counts: features of the state within `gates`, and stereo pairs of the map within a
    squared distance `map_gate`. A feature that did not fit for so many `failures` in a row leaves;
    a body is seen by at `least` so many, one of them in both views if the frame has such features:
    a single one may be of what hides it, and what stereo does not match may be its edge."""

    gates: Gates
    map_gate: float
    failures: int
    least: int


def advance_body(body: Body, frame: FrameViews, m: Manoeuvres, rules: Rules) -> Body:
    """The body predicted to a frame and updated by its features there, if it is seen."""
    # 1 the body in the world as it is now, with the features that the frame has
    body = corrected(body, frame.correction)
    at = rows_of_ids(body.feature_id, frame.feature_id)
    body, at = with_state_of(body, at >= 0), at[at >= 0]
    # 2 the state
    n = len(at)
    xy, drift, last_xy = np.empty((n, 4)), np.empty(n), body.last_xy.copy()
    for i in range(n):
        for a in range(4):
            xy[i, a] = frame.xy[at[i], a]
        way = 0.0
        if math.isfinite(xy[i, 0] + xy[i, 1]):
            way = (xy[i, 0] - last_xy[i, 0]) ** 2 + (xy[i, 1] - last_xy[i, 1]) ** 2
            last_xy[i, 0], last_xy[i, 1] = xy[i, 0], xy[i, 1]
        drift[i] = frame.drift_variance
        if math.isfinite(way):
            drift[i] += frame.drift_per_flow**2 * way
    dt = 1e-9 * (frame.timestamp_ns - body.timestamp_ns)
    predicted = predict_body(body.state, dt, m, frame.step, drift)
    view = StereoView(xy, frame.T_cam0_world, frame.T_cam1_cam0, frame.variance)
    state, status, _ = update_body(predicted, view, rules.gates)
    failed, used, in_stereo = np.zeros(n, np.int64), 0, 0
    for i in range(n):
        if status[i] == REFUSED:
            failed[i] = body.failures[i] + 1
        elif status[i] == STEREO or status[i] == LEFT:
            used += 1
            in_stereo += status[i] == STEREO
    if used < rules.least or (in_stereo == 0 and is_stereo(frame)):
        state, status, used = predicted, np.full(n, UNSEEN), min(used, rules.least - 1)
    # 3 the map; what does not fit leaves both
    moved = Body(
        frame.timestamp_ns, state, body.feature_id, failed, last_xy, body.map, used
    )  # fmt: skip
    new = updated_map(moved, frame, status, rules.map_gate)
    fits = with_map(moved, chosen(new, new.failures < rules.failures))
    return with_state_of(fits, failed < rules.failures)


@part
def is_stereo(frame: FrameViews) -> bool:
    """Has a frame any feature in both views? What has no match then is at an edge, as a rule."""
    return bool(np.isfinite(frame.xy[:, 2]).any())


@part
def with_map(body: Body, new: FeatureMap) -> Body:
    """The body with another map."""
    return Body(
        body.timestamp_ns, body.state, body.feature_id, body.failures, body.last_xy, new,
        body.n_used,
    )  # fmt: skip


@part
def chosen(m: FeatureMap, kept: BoolArray) -> FeatureMap:
    """The features of a mask (m,)."""
    return FeatureMap(
        m.feature_id[kept], m.f[kept], m.cov[kept], m.n_seen[kept], m.failures[kept],
        m.followed[kept], m.outline[kept],
    )  # fmt: skip


@part
def with_state_of(body: Body, kept: BoolArray) -> Body:
    """The body with some of the features in its state (n,); the others stay in the map."""
    index, n = np.empty(len(body.state.P), np.int64), N_BODY
    for i in range(N_BODY):
        index[i] = i
    for i in range(len(kept)):
        if kept[i]:
            for a in range(3):
                index[n + a] = N_BODY + 3 * i + a
            n += 3
    P = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            P[a, b] = body.state.P[index[a], index[b]]
    return Body(
        body.timestamp_ns, BodyState(body.state.x, body.state.f[kept], P), body.feature_id[kept],
        body.failures[kept], body.last_xy[kept], body.map, body.n_used,
    )  # fmt: skip


@part
def corrected(body: Body, T_new_old: FloatArray) -> Body:
    """The body after a correction (4, 4) of the world that the rig's poses are in.

    A body is known relative to the rig: it goes with it. Its covariance stays, since corrections
    turn by little; what they tilt by, its features take on.
    """
    x, C = body.state.x, T_new_old
    moved, before, now = x.copy(), np.zeros((3, 3)), np.zeros((3, 3))
    for a in range(3):
        moved[a] = C[a, 0] * x[0] + C[a, 1] * x[1] + C[a, 2] * x[2] + C[a, 3]
        moved[4 + a] = C[a, 0] * x[4] + C[a, 1] * x[5] + C[a, 2] * x[6]
    moved[3] = x[3] + math.atan2(C[1, 0], C[0, 0])
    for a in range(2):
        moved[8 + a] = C[a, 0] * x[8] + C[a, 1] * x[9]
    turn(x[3], before)
    turn(moved[3], now)
    tilt = np.zeros((3, 3))  # nowᵀ C before
    for a in range(3):
        for b in range(3):
            for c in range(3):
                for d in range(3):
                    tilt[a, b] += now[c, a] * C[c, d] * before[d, b]
    m = body.map
    places = FeatureMap(
        m.feature_id, tilted(m.f, tilt), m.cov, m.n_seen, m.failures, m.followed, m.outline
    )
    return Body(
        body.timestamp_ns, BodyState(moved, tilted(body.state.f, tilt), body.state.P),
        body.feature_id, body.failures, body.last_xy, places, body.n_used,
    )  # fmt: skip


@part
def tilted(f: FloatArray, R: FloatArray) -> FloatArray:
    """Points (n, 3), turned by R (3, 3)."""
    out = np.empty_like(f)
    for i in range(len(f)):
        for a in range(3):
            out[i, a] = R[a, 0] * f[i, 0] + R[a, 1] * f[i, 1] + R[a, 2] * f[i, 2]
    return out


@inlined_part
def turn(yaw: float, R: FloatArray) -> None:
    """R (3, 3), zero before: the rotation about z."""
    c, s = math.cos(yaw), math.sin(yaw)
    R[0, 0], R[0, 1], R[1, 0], R[1, 1], R[2, 2] = c, -s, s, c, 1.0


@part
def updated_map(body: Body, frame: FrameViews, status: IntArray, bound: float) -> FeatureMap:
    """The map with the features of the state, by their `status` (n,), and with the other followed
    ones updated by their stereo pairs."""
    m, x = body.map, body.state.x
    at = rows_of_ids(m.feature_id, frame.feature_id)
    row = rows_of_ids(m.feature_id, body.feature_id)
    f, cov, n_seen, failures = m.f.copy(), m.cov.copy(), m.n_seen.copy(), m.failures.copy()
    followed, p, C = m.followed.copy(), np.empty(3), np.empty((3, 3))
    for k in range(len(at)):
        followed[k] = m.followed[k] and at[k] >= 0
        if row[k] >= 0:
            i, first = row[k], N_BODY + 3 * row[k]
            for a in range(3):
                f[k, a] = body.state.f[i, a]
                for b in range(3):
                    cov[k, a, b] = body.state.P[first + a, first + b]
            failures[k] = body.failures[i]
            n_seen[k] += status[i] == STEREO
        elif followed[k] and math.isfinite(frame.p_world[at[k], 0]):
            in_frame_of(x, body.state.P, frame.p_world[at[k]], frame.cov_world[at[k]], p, C)
            fits = update_place(f[k], cov[k], p, C, bound)
            n_seen[k] += fits
            failures[k] = 0 if fits else failures[k] + 1
    return FeatureMap(m.feature_id, f, cov, n_seen, failures, followed, m.outline)


@part
def in_frame_of(
    x: FloatArray, P: FloatArray, p_world: FloatArray, cov_world: FloatArray, f: FloatArray,
    C: FloatArray,
) -> None:  # fmt: skip
    """A point (3,) in world with covariance (3, 3) in the frame of a body of state x (11,): `f`
    (3,) and `C` (3, 3), the body's own covariance, of p and ψ in P, included."""
    c, s = math.cos(x[3]), math.sin(x[3])
    rx, ry, rz = p_world[0] - x[0], p_world[1] - x[1], p_world[2] - x[2]
    W = np.empty((3, 3))
    by_yaw = (ry, -rx, 0.0)  # derivative of the place, turned back into the world, by the yaw
    for a in range(3):
        for b in range(3):
            W[a, b] = cov_world[a, b] + P[a, b] + by_yaw[a] * by_yaw[b] * P[3, 3]
            W[a, b] -= P[a, 3] * by_yaw[b] + by_yaw[a] * P[3, b]
    f[0], f[1], f[2] = c * rx + s * ry, c * ry - s * rx, rz
    turned_back(W, c, s, C)


@inlined_part
def turned_back(W: FloatArray, c: float, s: float, C: FloatArray) -> None:
    """C = Rᵀ W R (3, 3), R the rotation about z of cosine c and sine s."""
    for b in range(3):
        C[0, b], C[1, b], C[2, b] = c * W[0, b] + s * W[1, b], c * W[1, b] - s * W[0, b], W[2, b]
    for a in range(3):
        first, second = C[a, 0], C[a, 1]
        C[a, 0], C[a, 1] = c * first + s * second, c * second - s * first


@part
def update_place(
    f: FloatArray, cov: FloatArray, p: FloatArray, C: FloatArray, bound: float
) -> bool:  # fmt: skip
    """Update a place f (3,) with covariance (3, 3) by a measured one, if within the bound."""
    S, inverse, W, r = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for a in range(3):
        r[a] = p[a] - f[a]
        for b in range(3):
            S[a, b] = C[a, b] + cov[a, b]
    invert_symmetric(S, inverse)
    squared = 0.0
    for a in range(3):
        for b in range(3):
            squared += r[a] * inverse[a, b] * r[b]
            W[a, b] = 0.0
            for c in range(3):
                W[a, b] += cov[a, c] * inverse[c, b]
    if not squared < bound:
        return False
    before = cov.copy()
    for a in range(3):
        f[a] += W[a, 0] * r[0] + W[a, 1] * r[1] + W[a, 2] * r[2]
        for b in range(3):
            cov[a, b] -= W[a, 0] * before[0, b] + W[a, 1] * before[1, b] + W[a, 2] * before[2, b]
    return True


advance_body_compiled = compiled(advance_body, code_folder(Path(__file__)))
