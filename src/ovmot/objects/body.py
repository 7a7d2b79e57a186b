"""A body as the world of a rig that moves in it: its filter, its features and the map of them.

The state of `body_kernel` holds some of the features that are seen; the map holds all that were
ever seen of the body, in its own frame.
"""

from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.body_kernel import N_BODY, BodyState, Gates, Manoeuvres
from ovmot.objects.body_members_kernel import exchange_members_compiled
from ovmot.objects.body_step_kernel import (
    Body,
    FeatureMap,
    FrameViews,
    Rules,
    advance_body_compiled,
)
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
LEAST_SEEN = 2
"""Features by which a body is seen."""
RIGID_POINTS = 3
"""Points that show a rigid motion."""
_LIFT = 0.2  # m/s²/√Hz: slopes of roads
_IN_GATE, _IN_HUBER = 0.999, 0.9
GATES = Gates(
    (gate(2, _IN_GATE), gate(4, _IN_GATE)),
    (gate(2, _IN_HUBER), gate(4, _IN_HUBER)),
)
RULES = Rules(GATES, gate(3, _IN_GATE), failures=2, least=LEAST_SEEN)
VELOCITY = slice(4, 7)
_NONE = np.empty(0, np.int64)


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


class VelocityPrior(NamedTuple):
    """What is known of a body's velocity (3,), m/s, before it is measured, and its covariance."""

    mean: FloatArray
    covariance: FloatArray


ROAD_USERS = VelocityPrior(np.zeros(3), np.diag(np.square(ROAD_SPEED_SIGMA_MPS)))
"""Of a body of which nothing is known."""


def prior_of(body: Body) -> VelocityPrior:
    """What a body that was lost leaves: its predicted velocity."""
    return VelocityPrior(body.velocity, body.state.P[VELOCITY, VELOCITY])


def with_velocity_prior(body: Body, prior: VelocityPrior) -> Body:
    """The body with a prior of its velocity."""
    x, f, P = body.state
    H = np.eye(3, len(P), VELOCITY.start)
    S = P[VELOCITY, VELOCITY] + prior.covariance
    K = np.linalg.solve(S, H @ P).T
    step = K @ (prior.mean - x[VELOCITY])
    return body._replace(
        state=BodyState(x + step[:N_BODY], f + step[N_BODY:].reshape(-1, 3), P - K @ H @ P)
    )


def advance(body: Body, frame: FrameViews) -> Body:
    """The body predicted to a frame and updated by its features there."""
    return advance_body_compiled(body, frame, manoeuvres(frame.focal), RULES)


def with_members(body: Body, frame: FrameViews, feature_id: IntArray) -> Body:
    """The body with further features (k,) of a frame, by their stereo places, in its map."""
    return exchange_members_compiled(body, frame, _NONE, feature_id, True, 0)


def exchange_members(body: Body, frame: FrameViews, leaves: IntArray, joins: IntArray) -> Body:
    """The body without and with some features of a frame, and with followed ones of its map in the
    state, up to `MOST_IN_STATE`. The outline does not go around those that join."""
    return exchange_members_compiled(body, frame, leaves, joins, False, MOST_IN_STATE)


def with_filled_state(body: Body, frame: FrameViews) -> Body:
    """The body with followed features of its map in the state, up to `MOST_IN_STATE`."""
    return exchange_members_compiled(body, frame, _NONE, _NONE, False, MOST_IN_STATE)
