"""A body as the world of a rig that moves in it: its filter, its features and the map of them.

The state of `body_kernel` holds some of the features that are seen; the map holds all that were
ever seen of the body, in its own frame.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.so3 import rotation_z
from ovmot.kernels.table_kernel import columns_of_compiled
from ovmot.objects.body_kernel import (
    LEFT,
    N_BODY,
    REFUSED,
    STEREO,
    BodyState,
    Gates,
    Manoeuvres,
    StereoView,
    predict_body_compiled,
    update_body_compiled,
)
from ovmot.objects.frame_views import FrameViews
from ovmot.physics import (
    ACCEL_SIGMA_MPS2,
    LEAST_MATCH_SIGMA_PX,
    MANOEUVRE_S,
    ROAD_SPEED_SIGMA_MPS,
    YAW_RATE_SIGMA_RPS,
    gate,
)

MOST_IN_STATE = 20
"""Features in the state: more cost more than they tell."""
_FAILURES = 2  # in a row, after which a feature leaves
_LIFT = 0.2  # m/s²/√Hz: slopes of roads
_IN_GATE, _IN_HUBER = 0.999, 0.9
GATES = Gates(
    (gate(2, _IN_GATE), gate(4, _IN_GATE)),
    (gate(2, _IN_HUBER), gate(4, _IN_HUBER)),
)
VELOCITY = slice(4, 7)


@dataclass(frozen=True, slots=True)
class FeatureMap:
    """All features ever seen of a body: ids (m,), places (m, 3) in its frame with covariance
    (m, 3, 3), how often each was seen and how often in a row it did not fit (m,), whether it is
    still followed and whether the body's outline goes around it (m,)."""

    feature_id: IntArray
    f: FloatArray
    cov: FloatArray
    count: IntArray
    failures: IntArray
    followed: BoolArray
    outline: BoolArray

    def only(self, kept: BoolArray) -> "FeatureMap":
        """The features of a mask (m,)."""
        return FeatureMap(
            self.feature_id[kept], self.f[kept], self.cov[kept], self.count[kept],
            self.failures[kept], self.followed[kept], self.outline[kept],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Body:
    """A body at one time: its state, the ids (n,) of the features in it, how often in a row each
    did not fit, where each was last (n, 2), normalized, and the map."""

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
        return self.state.x[VELOCITY]

    @property
    def velocity_cov(self) -> FloatArray:
        """Its covariance (3, 3)."""
        return self.state.P[VELOCITY, VELOCITY]

    @property
    def rotation(self) -> FloatArray:
        """R_world_obj (3, 3)."""
        return rotation_z(float(self.state.x[3]))

    @property
    def has_outline(self) -> bool:
        """Is anything known of its shape?"""
        return bool(self.map.outline.any())

    @property
    def members(self) -> IntArray:
        """Ids (k,) of the features that are followed, rising."""
        return np.sort(self.map.feature_id[self.map.followed])


def manoeuvres(focal: float) -> Manoeuvres:
    """Those of road users, seen by cameras of a focal length in pixels."""
    match = LEAST_MATCH_SIGMA_PX / focal
    return Manoeuvres(ACCEL_SIGMA_MPS2, YAW_RATE_SIGMA_RPS, MANOEUVRE_S, _LIFT, match)


def empty_body(timestamp_ns: int, p: FloatArray, velocity: FloatArray) -> Body:
    """A body of no features at p (3,), which defines its frame, with a vague velocity (3,)."""
    x, P = np.zeros(N_BODY), np.zeros((N_BODY, N_BODY))
    x[:3], x[3], x[VELOCITY] = p, np.arctan2(velocity[1], velocity[0]), velocity
    P[VELOCITY, VELOCITY] = np.diag(np.square(_VAGUE * np.array(ROAD_SPEED_SIGMA_MPS)))
    P[7, 7] = YAW_RATE_SIGMA_RPS**2
    P[8, 8] = P[9, 9] = ACCEL_SIGMA_MPS2**2
    none, nothing = np.empty(0, np.int64), np.empty((0, 3))
    return Body(
        timestamp_ns, BodyState(x, nothing, P), none, none, np.empty((0, 2)),
        FeatureMap(none, nothing, np.empty((0, 3, 3)), none, none, none > 0, none > 0), 0,
    )  # fmt: skip


_VAGUE = 3.0  # times the prior: what starts the replay is but a place to linearize at


def with_velocity_prior(body: Body) -> Body:
    """The body with the prior of road users' velocities."""
    x, f, P = body.state
    H = np.eye(3, len(P), VELOCITY.start)
    S = P[VELOCITY, VELOCITY] + np.diag(np.square(ROAD_SPEED_SIGMA_MPS))
    K = np.linalg.solve(S, H @ P).T
    step = -K @ x[VELOCITY]
    state = BodyState(x + step[:N_BODY], f + step[N_BODY:].reshape(-1, 3), P - K @ H @ P)
    return replace(body, state=state)


def advance(body: Body, frame: FrameViews) -> Body:
    """The body predicted to a frame and updated by its features there."""
    body = corrected(body, frame.correction)
    at = columns_of_compiled(body.feature_id, frame.feature_id)
    body, at = _without(body, at >= 0), at[at >= 0]
    xy = frame.xy[at]
    drift = frame.drift_variance(xy[:, :2] - body.last_xy)
    dt = 1e-9 * (frame.timestamp_ns - body.timestamp_ns)
    predicted = predict_body_compiled(body.state, dt, manoeuvres(frame.focal), frame.step, drift)
    view = StereoView(xy, frame.T_cam0_world, frame.T_cam1_cam0, frame.variance)
    state, status, _ = update_body_compiled(predicted, view, GATES)
    used = (status == STEREO) | (status == LEFT)
    failures = np.where(status == REFUSED, body.failures + 1, 0)
    last_xy = np.where(np.isfinite(xy[:, :2]), xy[:, :2], body.last_xy)
    moved = Body(
        frame.timestamp_ns, state, body.feature_id, failures, last_xy, body.map, int(used.sum())
    )
    return _with_map(moved, frame, status)


def corrected(body: Body, T_new_old: FloatArray) -> Body:
    """The body after a correction (4, 4) of the world that the rig's poses are in.

    A body is known relative to the rig: it goes with it. Its covariance stays, since corrections
    turn by little.
    """
    x, f, P = body.state
    C, before = T_new_old[:3, :3], body.rotation
    moved = x.copy()
    moved[:3] = C @ x[:3] + T_new_old[:3, 3]
    moved[3] = x[3] + np.arctan2(C[1, 0], C[0, 0])
    moved[VELOCITY] = C @ x[VELOCITY]
    moved[8:10] = C[:2, :2] @ x[8:10]
    tilt = (rotation_z(float(moved[3])).T @ C @ before).T
    state = BodyState(moved, f @ tilt, P)
    return replace(body, state=state, map=replace(body.map, f=body.map.f @ tilt))


def _without(body: Body, kept: BoolArray) -> Body:
    """The body without some features in its state; they stay in the map."""
    if kept.all():
        return body
    x, f, P = body.state
    index = np.concatenate([np.ones(N_BODY, np.bool_), np.repeat(kept, 3)])
    state = BodyState(x, np.ascontiguousarray(f[kept]), np.ascontiguousarray(P[index][:, index]))
    return replace(
        body, state=state, feature_id=body.feature_id[kept], failures=body.failures[kept],
        last_xy=body.last_xy[kept],
    )  # fmt: skip


def _with_map(body: Body, frame: FrameViews, status: IntArray) -> Body:
    """The body with its map brought up to the frame; what does not fit leaves map and state."""
    m = body.map
    at = columns_of_compiled(m.feature_id, frame.feature_id)
    row = columns_of_compiled(m.feature_id, body.feature_id)
    f, cov, count, failures = m.f.copy(), m.cov.copy(), m.count.copy(), m.failures.copy()
    inside = row >= 0
    f[inside] = body.state.f[row[inside]]
    diagonal = N_BODY + 3 * row[inside][:, None] + np.arange(3)
    cov[inside] = body.state.P[diagonal[:, :, None], diagonal[:, None]]
    failures[inside] = body.failures[row[inside]]
    count[inside] += (status == STEREO)[row[inside]]
    others = np.flatnonzero(m.followed & ~inside & (at >= 0))
    others = others[np.isfinite(frame.p_world[at[others], 0])]
    if len(others):
        local, C = in_body(body, frame.p_world[at[others]], frame.cov_world[at[others]])
        S = C + cov[others]
        r = local - f[others]
        W = np.linalg.solve(S, cov[others]).transpose(0, 2, 1)
        fits = (r * np.linalg.solve(S, r[..., None])[..., 0]).sum(-1) < gate(3, _IN_GATE)
        f[others] += np.where(fits[:, None], (W @ r[..., None])[..., 0], 0.0)
        cov[others] -= np.where(fits[:, None, None], W @ cov[others], 0.0)
        count[others] += fits
        failures[others] = np.where(fits, 0, failures[others] + 1)
    followed = m.followed & (at >= 0)
    new = FeatureMap(m.feature_id, f, cov, count, failures, followed, m.outline)
    body = replace(body, map=new.only(failures < _FAILURES))
    return _without(body, body.failures < _FAILURES)


def in_body(
    body: Body, p_world: FloatArray, cov_world: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) in world and their covariance (N, 3, 3) in the body's frame, the body's own
    covariance included."""
    R, P = body.rotation, body.state.P
    r = p_world - body.state.x[:3]
    J = np.zeros((len(r), 3, 4))
    J[:, :, :3] = -np.eye(3)
    J[:, 0, 3], J[:, 1, 3] = r[:, 1], -r[:, 0]
    C = cov_world + J @ P[:4, :4] @ J.transpose(0, 2, 1)
    return r @ R, R.T @ C @ R


def with_members(
    body: Body, frame: FrameViews, feature_id: IntArray, *, outline: bool = True
) -> Body:
    """The body with further features (k,) of a frame, by their stereo places, in its map; its
    `outline` goes around them, or not."""
    m = body.map
    new = feature_id[columns_of_compiled(feature_id, m.feature_id) < 0]
    at = columns_of_compiled(new, frame.feature_id)
    seen = frame.has_place(at)
    new, at = new[seen], at[seen]
    if len(new):
        f, C = in_body(body, frame.p_world[at], frame.cov_world[at])
        one = np.ones(len(new), np.int64)
        m = FeatureMap(
            np.concatenate([m.feature_id, new]), np.concatenate([m.f, f]),
            np.concatenate([m.cov, C]), np.concatenate([m.count, one]),
            np.concatenate([m.failures, 0 * one]), np.concatenate([m.followed, one > 0]),
            np.concatenate([m.outline, np.full(len(new), outline)]),
        )  # fmt: skip
        body = replace(body, map=m)
    return body


def without_members(body: Body, ids: IntArray) -> Body:
    """The body without some features (k,), which another body holds."""
    kept = columns_of_compiled(body.map.feature_id, ids) < 0
    if kept.all():
        return body
    in_state = columns_of_compiled(body.feature_id, ids) < 0
    return _without(replace(body, map=body.map.only(kept)), in_state)


def with_filled_state(body: Body, frame: FrameViews) -> Body:
    """The body with followed features of its map in the state, up to `MOST_IN_STATE`.

    Of more than there is room for every k-th: features are in the order in which they were found.
    """
    room = MOST_IN_STATE - len(body.feature_id)
    m = body.map
    free = m.followed & (m.failures == 0)
    free &= columns_of_compiled(m.feature_id, body.feature_id) < 0
    at = columns_of_compiled(m.feature_id, frame.feature_id)
    free &= frame.has_place(at)
    index = np.flatnonzero(free)
    if room <= 0 or not len(index):
        return body
    index = index[:: -(-len(index) // room)]
    return _into_state(body, frame, m.feature_id[index], at[index])


def _into_state(body: Body, frame: FrameViews, ids: IntArray, at: IntArray) -> Body:
    """Delayed initialization of features (k,) at rows `at` (k,) of the frame, from its stereo pair:
    f = Rᵀ (X - p)."""
    x, f, P = body.state
    R, k, N = body.rotation, len(ids), len(P)
    r = frame.p_world[at] - x[:3]
    J = np.zeros((k, 3, 4))
    J[:, :, :3] = -R.T
    local = r @ R
    J[:, 0, 3], J[:, 1, 3] = local[:, 1], -local[:, 0]
    to_point = frame.p_world[at] - frame.T_world_cam0[:3, 3]
    depth = to_point @ frame.T_world_cam0[:3, 2]
    by_match = -(to_point @ R) * (depth / frame.baseline)[:, None]
    local = local + x[10] * by_match
    by = np.concatenate([J, by_match[:, :, None]], axis=2).reshape(3 * k, 5)
    pose = np.array([0, 1, 2, 3, 10])
    cross = by @ P[pose]
    grown = np.zeros((N + 3 * k, N + 3 * k))
    grown[:N, :N] = P
    grown[N:, :N], grown[:N, N:] = cross, cross.T
    grown[N:, N:] = by @ P[np.ix_(pose, pose)] @ by.T
    C = R.T @ frame.cov_world[at] @ R
    for i in range(k):
        here = slice(N + 3 * i, N + 3 * i + 3)
        grown[here, here] += C[i]
    return replace(
        body,
        state=BodyState(x, np.concatenate([f, local]), grown),
        feature_id=np.concatenate([body.feature_id, ids]),
        failures=np.concatenate([body.failures, np.zeros(k, np.int64)]),
        last_xy=np.concatenate([body.last_xy, frame.xy[at, :2]]),
    )
