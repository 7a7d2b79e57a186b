"""Which features tracks hold, which join them, and which velocities they hand on."""

import numpy as np
from object_fixtures import feature_motions, frame_of, make_track, scene_points

from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body_box import GAP_M
from ovmot.objects.track import TrackState
from ovmot.objects.track_features import (
    LIMITS,
    are_seen,
    held_by,
    hidden_features,
    hidden_places,
    hulls_of,
    ids_of,
    moving_of,
    own_features,
    owners,
    velocities_of_members,
    with_exchanged_features,
)
from ovmot.objects.track_features_kernel import near_hulls_compiled
from ovmot.physics import CAR_SIZE_M

END_M = 0.5 * CAR_SIZE_M[0]


def test_a_feature_is_of_the_track_that_holds_it() -> None:
    tracks = [
        make_track(ids=[1, 2], track_id=4), make_track(ids=[5], track_id=9),
        make_track(ids=[8], track_id=3, state=TrackState.COASTING),
    ]  # fmt: skip
    ids = np.array([5, 1, 7, 8])
    owner = owners(held_by(tracks), are_seen(tracks), ids)
    assert ids_of(tracks)[owner].tolist() == [9, 4, -1, -1]
    assert ids_of([])[owners(held_by([]), are_seen([]), ids)].tolist() == [-1] * 4


def test_features_are_near_the_box_along_the_heading() -> None:
    track = make_track((10.0, 0.0, 1.0), (0.0, 5.0, 0.0), sigma=0.1)  # along y
    p = np.array([[10.0, 2.5, 1.0], [15.0, 0.0, 1.0], [10.0, 0.0, 9.0], [np.nan] * 3])
    seen = feature_motions(np.zeros((4, 3)), p)
    near = near_hulls_compiled(hulls_of([track]), moving_of(seen), LIMITS)
    assert near.tolist() == [[True, False, False, False]]
    assert near_hulls_compiled(hulls_of([]), moving_of(seen), LIMITS).shape == (0, 4)


def test_a_point_belongs_if_a_vehicle_can_reach_to_it() -> None:
    tracks = [make_track((10.0, 0.0, 1.6))]
    p = np.array([
        [10.0 + END_M + GAP_M - 0.3, 0.0, 1.6], [10.0 + END_M + GAP_M + 0.7, 0.0, 1.6],
        [10.0, 3.5, 1.6],
    ])  # fmt: skip
    p_cam0 = np.stack([-p[:, 1], 1.6 - p[:, 2], p[:, 0]], axis=1)
    frame = frame_of(scene_points([2, 2, 2], p_cam0=p_cam0))
    own = own_features(tracks, hulls_of(tracks), 0, np.arange(3), frame)
    assert own.tolist() == [0]
    beside = [*tracks, make_track((10.0 + END_M + 3.5, 0.0, 1.6), track_id=8)]
    assert own_features(beside, hulls_of(beside), 0, np.arange(3), frame).tolist() == []


def test_features_with_a_bodys_velocity_join_and_those_at_rest_leave() -> None:
    v = np.array([[5.0, 0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [np.nan] * 3])
    seen = feature_motions(v, np.tile([10.0, 0.0, 1.6], (5, 1)))
    frame = frame_of(scene_points([0] * 5, p_cam0=np.tile([0.0, 0.0, 10.0], (5, 1))))
    track = make_track((10.0, 0.0, 1.6), (5.0, 0.0, 0.0), ids=[2])
    (after,) = with_exchanged_features([track], hulls_of([track]), seen, frame)
    assert after.feature_id.tolist() == [0]
    # a body that may be at rest gains none
    slow = make_track((10.0, 0.0, 1.6), (0.3, 0.0, 0.0), sigma=1.0)
    (after,) = with_exchanged_features([slow], hulls_of([slow]), seen, frame)
    assert after.feature_id.tolist() == []


def test_what_moves_on_with_a_track_is_its_own_and_what_is_new_in_its_box() -> None:
    v = np.array([[5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [np.nan] * 3, [np.nan] * 3])
    p = np.array([[90.0, 0.0, 0.0], [10.0, 0.0, 1.6], [10.0, 0.0, 1.6], [50.0, 0.0, 1.6]])
    track = make_track((10.0, 0.0, 1.6), (5.0, 0.0, 0.0), ids=[0])
    ids, velocity = velocities_of_members(
        held_by([track]), hulls_of([track]), feature_motions(v, p)
    )
    assert ids.tolist() == [0, 2]
    np.testing.assert_allclose(velocity, np.tile(track.velocity, (2, 1)))
    assert len(velocities_of_members(held_by([]), hulls_of([]), feature_motions(v, p))[0]) == 0


def test_where_the_features_of_hidden_bodies_are() -> None:
    """Those of tracks that coast, in the left camera, and the places where the bodies may stand."""
    seen = make_track((10.0, 0.0, 1.6), ids=[1])
    seen = seen._replace(body=seen.body._replace(n_used=5))
    lost = make_track((20.0, 4.0, 1.6), (0.0, -8.0, 0.0), [2], 9, TrackState.COASTING)
    now_ns = lost.updated_ns + 500_000_000
    frame = frame_of(scene_points([]), now_ns)
    hidden = hidden_features([seen, lost], frame)
    np.testing.assert_array_equal(np.sort(hidden.feature_id), np.sort(lost.body.map.feature_id))
    corners = lost.body.state.x[:3] + lost.body.map.f @ rotation_z(float(lost.body.state.x[3])).T
    expected = np.stack([-corners[:, 1], 1.6 - corners[:, 2], corners[:, 0]], axis=1)
    order = np.argsort(lost.body.map.feature_id)
    np.testing.assert_allclose(hidden.p_cam0[np.argsort(hidden.feature_id)], expected[order])
    np.testing.assert_allclose(hidden.velocity, [[8.0, 0.0, 0.0]] * len(corners), atol=1e-12)
    assert (hidden.sigma_m > 0.1).all()  # more than the track's own
    # it goes on to y = 4, or has braked by 1 m
    places = hidden_places([seen, lost], frame)
    np.testing.assert_allclose(places[[0, -1]], [[-4.0, 0.0, 20.0], [-5.0, 0.0, 20.0]], atol=1e-5)
    assert len(hidden_features([seen], frame).feature_id) == len(hidden_places([seen], frame)) == 0
