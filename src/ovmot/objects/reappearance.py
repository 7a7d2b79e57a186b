"""A body that nobody saw for a while, and where it is when its features are seen again.

It may have braked meanwhile by anything up to fully, and may stand.
"""

from typing import NamedTuple

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.id_sets import positions
from ovmot.objects.body import MOST_IN_STATE, RIGID_POINTS, RULES, VELOCITY
from ovmot.objects.body_kernel import N_BODY, BodyState
from ovmot.objects.body_members_kernel import exchange_members_compiled
from ovmot.objects.body_step_kernel import Body, FeatureMap, FrameViews
from ovmot.physics import FULL_BRAKING_MPS2, UNIFORM_VARIANCE


class Braking(NamedTuple):
    """By how much a body is late (2,), metres, and slower (2,), m/s, if it braked unseen."""

    late: FloatArray
    slower: FloatArray


def full_braking(body: Body, seconds: float) -> Braking:
    """Of `FULL_BRAKING_MPS2` for so long, until it stands."""
    v = body.state.x[VELOCITY][:2]
    speed = max(float(np.hypot(v[0], v[1])), 1e-9)
    late_m = min(0.5 * FULL_BRAKING_MPS2 * seconds**2, speed * seconds)
    return Braking(late_m * v / speed, min(FULL_BRAKING_MPS2 * seconds, speed) * v / speed)


def unseen(body: Body, seconds: float) -> Body:
    """The body as uncertain as one that nobody saw for so long: it may have braked by anything up
    to fully, and may stand by now."""
    x, f, P = body.state
    braking, off = full_braking(body, seconds), np.zeros(len(P))
    off[:2], off[4:6] = braking.late, braking.slower
    return body._replace(state=BodyState(x, f, P + UNIFORM_VARIANCE * np.outer(off, off)))


def body_seen_again(body: Body, before: FeatureMap, frame: FrameViews, unseen_s: float) -> Body:
    """A body predicted to a frame, `unseen_s` after it was seen last, where features are seen again
    in stereo that its map of `before` had lost; as it is, if they are too few or disagree.

    The median of their displacements is that of the body. They get places anew: the map has them as
    they looked from elsewhere. If it is late it has braked, and goes more slowly.
    """
    lost = np.flatnonzero(~before.followed)
    at = positions(before.feature_id[lost], frame.feature_id)
    lost, at = lost[at >= 0], at[at >= 0]
    in_stereo = np.isfinite(frame.p_world[at, 0])
    lost, at = lost[in_stereo], at[in_stereo]
    if len(lost) < RIGID_POINTS:
        return body
    x, _, P = body.state
    off = frame.p_world[at] - x[:3] - before.f[lost] @ so3.rotation_z(x[3]).T
    C = frame.cov_world[at] + before.cov[lost]
    step = np.median(off, axis=0)
    agrees = _squared_distances(off - step, C) < RULES.map_gate
    of_step = C[agrees].sum(axis=0) / max(agrees.sum(), 1) ** 2
    reach = unseen(body, unseen_s).state.P[:3, :3] + of_step
    near = _squared_distances(step[None], reach[None])[0] < RULES.map_gate
    if agrees.sum() < RIGID_POINTS or not near:
        return body
    braking = full_braking(body, unseen_s)
    share, of_share = share_of_braking(braking, -step[:2], of_step[:2, :2])
    slower = braking.slower
    moved, alone = x.copy(), np.diag(np.diag(P)[:N_BODY])
    moved[:3] += step
    moved[4:6] -= share * slower
    moved[7:10] = 0.0
    alone[:3, :3] = of_step
    alone[4:6, 4:6] += of_share * np.outer(slower, slower)
    own = before.feature_id[lost[agrees]]
    placed = body._replace(
        state=BodyState(moved, np.empty((0, 3)), alone), feature_id=own[:0],
        failures=np.zeros(0, np.int64), last_xy=np.empty((0, 2)), n_used=len(own),
    )  # fmt: skip
    return exchange_members_compiled(placed, frame, own, own, True, MOST_IN_STATE)


def share_of_braking(full: Braking, late: FloatArray, of_late: FloatArray) -> tuple[float, float]:
    """Which share of full braking makes a body `late` (2,) with covariance (2, 2), and its
    variance; half of it if that does not tell."""
    squared = float(full.late @ full.late)
    variance = float(full.late @ of_late @ full.late) / max(squared, 1e-12) ** 2
    if variance > UNIFORM_VARIANCE:
        return 0.5, UNIFORM_VARIANCE
    return min(max(float(full.late @ late) / squared, 0.0), 1.0), variance


def _squared_distances(r: FloatArray, C: FloatArray) -> FloatArray:
    """Of residuals (n, 3) with covariances (n, 3, 3)."""
    return np.asarray((r * np.linalg.solve(C, r[..., None])[..., 0]).sum(axis=-1))
