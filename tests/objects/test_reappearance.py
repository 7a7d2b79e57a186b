"""A body that nobody saw for a while is found again by its features, where it is by then."""

import numpy as np
import pytest
from object_fixtures import frame_of, make_body, scene_points, small_rig

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_step_kernel import Body, FeatureMap, FrameViews
from ovmot.objects.reappearance import (
    Braking,
    body_seen_again,
    full_braking,
    share_of_braking,
    unseen,
)
from ovmot.physics import FULL_BRAKING_MPS2

SPEED_MPS, UNSEEN_S = 8.0, 0.8
PLACES = np.array([[2.0, 0.8, 0.0], [1.0, 0.8, 0.5], [-1.0, 0.8, -0.3], [-2.0, 0.8, 0.6]])
"""Of the features 1 to 4 on the side that the rig sees, in the body's frame: x is ahead."""


def hidden_body() -> Body:
    """Predicted to (20, 4 - 8 t), on its way to the right; none of its features is followed."""
    y = 4.0 - SPEED_MPS * UNSEEN_S
    body = make_body((20.0, y, 1.6), (0.0, -SPEED_MPS, 0.0))
    n = len(PLACES)
    of_map = FeatureMap(
        1 + np.arange(n), PLACES, np.broadcast_to(4e-4 * np.eye(3), (n, 3, 3)).copy(),
        np.full(n, 5), np.zeros(n, np.int64), np.zeros(n, np.bool_), np.ones(n, np.bool_),
    )  # fmt: skip
    return body._replace(map=of_map)


def seen(body: Body, late_m: float, n: int, off: FloatArray | None = None) -> FrameViews:
    """The first n features, where a body has them that is so late; by so much off (n, 3)."""
    x = body.state.x
    R = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # it goes along -y
    p = x[:3] + PLACES[:n] @ R.T + [0.0, late_m, 0.0] + (np.zeros(3) if off is None else off)
    p_cam0 = np.stack([-p[:, 1], 1.6 - p[:, 2], p[:, 0]], axis=1)
    rig = small_rig()
    pixels = np.hstack([rig.cam0.project(p_cam0), rig.cam1.project(p_cam0 - [0.47, 0.0, 0.0])])
    points = scene_points([0] * n, feature_id=1 + np.arange(n), p_cam0=p_cam0, pixels=pixels)
    return frame_of(points)


@pytest.mark.parametrize("braked", [False, True])
def test_a_body_is_where_its_features_are(braked: bool) -> None:
    """One that went on as before, and one that braked fully from the moment it was hidden."""
    body = hidden_body()
    late_m = 0.5 * FULL_BRAKING_MPS2 * UNSEEN_S**2 if braked else 0.0
    found = body_seen_again(body, body.map, seen(body, late_m, 4), UNSEEN_S)
    np.testing.assert_allclose(found.state.x[:3] - body.state.x[:3], [0.0, late_m, 0.0], atol=1e-6)
    slower = FULL_BRAKING_MPS2 * UNSEEN_S if braked else 0.0
    np.testing.assert_allclose(found.velocity, [0.0, slower - SPEED_MPS, 0.0], atol=1e-5)
    assert found.members.tolist() == [1, 2, 3, 4]
    assert sorted(found.feature_id.tolist()) == [1, 2, 3, 4]
    np.testing.assert_allclose(found.state.f[np.argsort(found.feature_id)], PLACES, atol=1e-6)
    assert found.n_used == 4
    assert np.linalg.eigvalsh(found.state.P).min() > -1e-12


def test_features_that_are_few_or_disagree_or_too_far_show_nothing() -> None:
    body = hidden_body()
    off = np.zeros((4, 3))
    off[1:, 0] = [0.0, 3.0, -3.0]
    for frame in (
        seen(body, 0.0, 0),
        seen(body, 0.0, 2),
        seen(body, 0.0, 4, off),
        seen(body, 9.0, 4),
    ):
        assert body_seen_again(body, body.map, frame, UNSEEN_S) is body


def test_one_wrong_feature_is_left_out() -> None:
    body = hidden_body()
    off = np.zeros((4, 3))
    off[3] = [0.0, 1.5, 0.0]
    found = body_seen_again(body, body.map, seen(body, 0.5, 4, off), UNSEEN_S)
    assert found.members.tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.state.x[1] - body.state.x[1], 0.5, atol=0.05)


def test_the_share_of_braking_is_known_if_the_place_is() -> None:
    full = Braking(np.array([0.0, -2.0]), np.array([0.0, -5.0]))
    share, variance = share_of_braking(full, np.array([0.3, -1.0]), 0.01 * np.eye(2))
    assert share == pytest.approx(0.5)
    assert variance == pytest.approx(0.01 / 4.0)
    assert share_of_braking(full, np.array([0.0, 1.0]), 0.01 * np.eye(2))[0] == 0.0
    assert share_of_braking(full, np.array([0.0, -9.0]), 0.01 * np.eye(2))[0] == 1.0
    assert share_of_braking(full, np.zeros(2), 4.0 * np.eye(2)) == (0.5, 1.0 / 12.0)


def test_a_body_that_stopped_unseen_is_known_worse_along_its_way() -> None:
    body = make_body((20.0, 4.0, 1.6), (0.0, -8.0, 0.0))
    braking = full_braking(body, 0.5)
    np.testing.assert_allclose(braking.late, [0.0, -FULL_BRAKING_MPS2 / 8.0], atol=1e-12)
    np.testing.assert_allclose(braking.slower, [0.0, -FULL_BRAKING_MPS2 / 2.0], atol=1e-12)
    stands = full_braking(body, 3.0)
    assert np.hypot(*stands.slower) == pytest.approx(8.0)  # no less than nothing
    P, wider = body.state.P, unseen(body, 0.5).state.P
    assert wider[1, 1] == pytest.approx(P[1, 1] + braking.late[1] ** 2 / 12.0)
    assert wider[0, 0] == pytest.approx(P[0, 0])
    assert np.linalg.eigvalsh(wider).min() > -1e-12
    at_rest = make_body(velocity=(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(unseen(at_rest, 1.0).state.P, at_rest.state.P)
