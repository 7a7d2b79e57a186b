"""The compiled change of a body's features equals its plain NumPy twin."""

import numpy as np
import pytest
from body_twins import assert_same, in_body, only, rows, some_body, some_frame, with_state

from ovmot.geometry.arrays import IntArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body_kernel import N_BODY, BodyState
from ovmot.objects.body_members_kernel import exchange_members_compiled
from ovmot.objects.body_step_kernel import Body, FeatureMap, FrameViews


def joined(body: Body, frame: FrameViews, ids: IntArray, outline: bool) -> Body:
    at = rows(ids, frame.feature_id)
    new = (rows(ids, body.map.feature_id) < 0) & np.isfinite(frame.p_world[at, 0])
    f, C = in_body(body, frame.p_world[at[new]], frame.cov_world[at[new]])
    one = np.ones(len(f), np.int64)
    more = FeatureMap(ids[new], f, C, one, 0 * one, one > 0, np.full(len(f), outline))
    pairs = zip(body.map, more, strict=True)
    return body._replace(map=FeatureMap(*(np.concatenate(pair) for pair in pairs)))


def filled(body: Body, frame: FrameViews, most: int) -> Body:
    m, room = body.map, most - len(body.feature_id)
    at = rows(m.feature_id, frame.feature_id)
    free = m.followed & (m.failures == 0) & (rows(m.feature_id, body.feature_id) < 0) & (at >= 0)
    free[free] = np.isfinite(frame.p_world[at[free], 0])
    index = np.flatnonzero(free)
    if room <= 0 or not len(index):
        return body
    index = index[:: -(-len(index) // room)]
    (x, f, P), k, at = body.state, len(index), at[index]
    R, n = rotation_z(float(x[3])), len(P)
    local = (frame.p_world[at] - x[:3]) @ R
    to_point = frame.p_world[at] - frame.T_world_cam0[:3, 3]
    depth = to_point @ frame.T_world_cam0[:3, 2]
    J = np.zeros((k, 3, n))
    J[:, :, :3] = -R.T
    J[:, 0, 3], J[:, 1, 3] = local[:, 1], -local[:, 0]
    J[:, :, 10] = -(to_point @ R) * (depth / frame.baseline)[:, None]
    G = np.concatenate([np.eye(n), J.reshape(3 * k, n)])
    grown = G @ P @ G.T
    for i in range(k):
        here = slice(n + 3 * i, n + 3 * i + 3)
        grown[here, here] += R.T @ frame.cov_world[at[i]] @ R
    return body._replace(
        state=BodyState(x, np.concatenate([f, local + x[10] * J[:, :, 10]]), grown),
        feature_id=np.concatenate([body.feature_id, m.feature_id[index]]),
        failures=np.concatenate([body.failures, np.zeros(k, np.int64)]),
        last_xy=np.concatenate([body.last_xy, frame.xy[at, :2]]),
    )


@pytest.mark.parametrize(
    ("leaves", "joins", "most"),
    [([], [10, 11, 13, 2, 4], 20), ([0, 6], [12], 7), ([3], [], 0), ([], [], 9)],
)
def test_an_exchange_is_that_of_the_plain_twin(
    leaves: list[int], joins: list[int], most: int
) -> None:
    rng = np.random.default_rng(4)
    body = some_body(rng)
    frame = some_frame(rng, body)
    out, into = np.array(leaves, np.int64), np.array(joins, np.int64)
    found = exchange_members_compiled(body, frame, out, into, bool(most == 7), most)
    kept = body._replace(map=only(body.map, ~np.isin(body.map.feature_id, out)))
    expected = with_state(kept, ~np.isin(body.feature_id, out))
    if joins:
        expected = joined(expected, frame, into, most == 7)
    assert_same(found, filled(expected, frame, most))
    assert len(found.feature_id) <= max(most, len(body.feature_id))
    assert found.state.P.shape == (N_BODY + 3 * len(found.feature_id),) * 2
