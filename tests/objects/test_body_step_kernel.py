"""The compiled step of a body equals its plain NumPy twin."""

import numpy as np
import pytest
from body_twins import assert_same, in_body, only, rows, some_body, some_frame, with_state

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body import RULES, manoeuvres
from ovmot.objects.body_kernel import (
    LEFT,
    N_BODY,
    REFUSED,
    STEREO,
    UNSEEN,
    BodyState,
    StereoView,
    predict_body,
    update_body,
)
from ovmot.objects.body_step_kernel import Body, FeatureMap, FrameViews, advance_body_compiled


def corrected(body: Body, T: FloatArray) -> Body:
    x, f, P = body.state
    C, moved = T[:3, :3], x.copy()
    moved[:3], moved[4:7], moved[8:10] = C @ x[:3] + T[:3, 3], C @ x[4:7], C[:2, :2] @ x[8:10]
    moved[3] += np.arctan2(C[1, 0], C[0, 0])
    tilt = rotation_z(float(moved[3])).T @ C @ rotation_z(float(x[3]))
    state = BodyState(moved, f @ tilt.T, P)
    return body._replace(state=state, map=body.map._replace(f=body.map.f @ tilt.T))


def updated_map(body: Body, frame: FrameViews, status: IntArray) -> FeatureMap:
    m = body.map
    at, row = rows(m.feature_id, frame.feature_id), rows(m.feature_id, body.feature_id)
    f, cov, n_seen, failures = m.f.copy(), m.cov.copy(), m.n_seen.copy(), m.failures.copy()
    followed = m.followed & (at >= 0)
    for k in range(len(at)):
        if row[k] >= 0:
            here = slice(N_BODY + 3 * row[k], N_BODY + 3 * row[k] + 3)
            f[k], cov[k] = body.state.f[row[k]], body.state.P[here, here]
            failures[k] = body.failures[row[k]]
            n_seen[k] += status[row[k]] == STEREO
        elif followed[k] and np.isfinite(frame.p_world[at[k], 0]):
            p, C = in_body(body, frame.p_world[at[k], None], frame.cov_world[at[k], None])
            S, r = C[0] + cov[k], p[0] - f[k]
            if r @ np.linalg.solve(S, r) < RULES.map_gate:
                W = cov[k] @ np.linalg.inv(S)
                f[k], cov[k], failures[k] = f[k] + W @ r, cov[k] - W @ cov[k], 0
                n_seen[k] += 1
            else:
                failures[k] += 1
    return m._replace(f=f, cov=cov, n_seen=n_seen, failures=failures, followed=followed)


def advanced(body: Body, frame: FrameViews) -> Body:
    """The plain twin of `advance_body`."""
    body = corrected(body, frame.correction)
    body = with_state(body, rows(body.feature_id, frame.feature_id) >= 0)
    xy = frame.xy[rows(body.feature_id, frame.feature_id)]
    way = np.nan_to_num(((xy[:, :2] - body.last_xy) ** 2).sum(-1))
    drift = frame.drift_variance + frame.drift_per_flow**2 * way
    predicted = predict_body(body.state, 0.1, manoeuvres(frame.focal), frame.step, drift)
    view = StereoView(xy, frame.T_cam0_world, frame.T_cam1_cam0, frame.variance)
    state, status, _ = update_body(predicted, view, RULES.gates)
    used = int(((status == STEREO) | (status == LEFT)).sum())
    failures = np.where(status == REFUSED, body.failures + 1, 0)
    pairs = np.isfinite(frame.xy[:, 2]).any()
    if used < RULES.least or (pairs and not (status == STEREO).any()):
        state, status = predicted, np.full_like(status, UNSEEN)
        used = min(used, RULES.least - 1)
    last_xy = np.where(np.isfinite(xy[:, :2]), xy[:, :2], body.last_xy)
    moved = body._replace(
        timestamp_ns=frame.timestamp_ns, state=state, last_xy=last_xy, failures=failures,
        n_used=used,
    )  # fmt: skip
    m = updated_map(moved, frame, status)
    fits = moved._replace(map=only(m, m.failures < RULES.failures))
    return with_state(fits, moved.failures < RULES.failures)


@pytest.mark.parametrize("before", [0, 1])
def test_a_step_is_that_of_the_plain_twin(before: int) -> None:
    """What did not fit twice in a row leaves; the others of the map are updated or fail."""
    rng = np.random.default_rng(3)
    body = some_body(rng)
    body.failures[3] = before
    frame = some_frame(rng, body)
    found = advance_body_compiled(body, frame, manoeuvres(frame.focal), RULES)
    assert_same(found, advanced(body, frame))
    assert (3 in found.feature_id) is (before == 0)
    assert 1 not in found.feature_id and 1 in found.map.feature_id
    assert 7 not in found.map.feature_id  # the pair of a wrong match, for the second time


@pytest.mark.parametrize("one_camera", [False, True])
def test_views_without_a_match_show_a_body_only_where_none_has_one(one_camera: bool) -> None:
    """What stereo does not match lies at an edge, unless the right picture is missing."""
    rng = np.random.default_rng(3)
    body = some_body(rng)
    frame = some_frame(rng, body)
    other = ~np.isin(frame.feature_id, body.map.feature_id)
    frame.xy[:, 2:] = np.where((other & (not one_camera))[:, None], frame.xy[:, 2:], np.nan)
    found = advance_body_compiled(body, frame, manoeuvres(frame.focal), RULES)
    assert_same(found, advanced(body, frame))
    assert (found.n_used >= RULES.least) is one_camera


def test_a_single_feature_does_not_move_a_body() -> None:
    """It may be of what hides it."""
    rng = np.random.default_rng(3)
    body = some_body(rng)
    frame = some_frame(rng, body)
    for n in range(len(frame.xy)):
        if frame.feature_id[n] != 4:
            frame.xy[n] = np.nan
    found = advance_body_compiled(body, frame, manoeuvres(frame.focal), RULES)
    assert_same(found, advanced(body, frame))
    assert found.n_used == 1
    step = 0.1 * body.state.x[6]
    lifted = corrected(body, frame.correction).state.x[2]
    assert found.state.x[2] == pytest.approx(lifted + step, abs=0.02)  # as predicted
