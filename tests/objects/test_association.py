"""Data association: distances, gates, common features."""

import numpy as np
import pytest
from object_fixtures import make_track, measurement

from ovmot.objects.association import (
    assign,
    associate,
    common_features,
    innovations,
    log_odds_of_old,
)
from ovmot.objects.track import DRIVES_MPS
from ovmot.physics import CAR_SIZE_M


@pytest.mark.parametrize("speed", [DRIVES_MPS - 0.5, DRIVES_MPS + 0.5])
def test_distances_are_those_of_the_state_and_of_where_the_points_may_lie(speed: float) -> None:
    """A quarter of the size to either side; of what drives the other end may be seen."""
    track = make_track((5.0, 0.0, 1.0), (speed, 0.0, 0.0))
    seen = measurement((5.6, 0.2, 1.0), (speed + 0.3, 0.1, 0.0), span_s=0.4)
    _, found = innovations([track], [seen], track.measured_ns + 200_000_000)
    R = seen.covariance.copy()
    R[:3, :3] += (0.25 * track.size[0]) ** 2 * np.eye(3)
    S = track.covariance + 2.0 * R  # of 0.4 s, in 0.2 s
    if speed > DRIVES_MPS:
        S[0, 0] += (0.25 * max(CAR_SIZE_M[0] - track.size[0], 0.0)) ** 2
    np.testing.assert_allclose(found[0, 0], S, atol=1e-9)


@pytest.mark.parametrize(("sigma_m", "likelier"), [(1.0, True), (4.0, True), (45.0, False)])
def test_a_place_that_is_hardly_known_tells_no_old_body_from_a_new_one(
    sigma_m: float, likelier: bool
) -> None:
    seen = measurement((1.0, 0.0, 0.0), (4.0, 0.0, 0.0))
    r = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])[None, None]
    S = np.diag([sigma_m**2, sigma_m**2, 1.0, 6.0**2, 6.0**2, 1.0])[None, None]
    odds = float(log_odds_of_old(r, S, [seen])[0, 0])
    assert (odds > 0.0) is likelier
    place = 1.0 / (2.0 * np.pi * sigma_m**2) * np.exp(-0.5 / sigma_m**2) * 700.0
    road = 100.0 + 0.01
    velocity = road / 36.0 * np.exp(-0.5 / 36.0 + 0.5 * 16.0 / road)
    assert odds == pytest.approx(np.log(place * velocity))


def test_common_features_are_a_share_of_the_smaller_set() -> None:
    tracks = [np.array([1, 2, 3, 4]), np.array([8, 9])]
    share, count = common_features(tracks, [np.array([9, 4, 3, 20]), np.array([30])])
    np.testing.assert_array_equal(count, [[2, 0], [1, 0]])
    np.testing.assert_allclose(share, [[0.5, 0.0], [0.5, 0.0]])


def test_shared_features_and_gates_decide() -> None:
    far = np.array([[30.0, 900.0], [900.0, 500.0]])
    share, count = np.array([[0.9, 0.0], [0.0, 0.9]]), np.array([[5, 0], [0, 5]])
    assert assign(far, share, count) == [(0, 0)]  # the second pair is absurdly far
    assert assign(np.full((1, 1), 5.0), np.zeros((1, 1)), np.zeros((1, 1), int)) == [(0, 0)]
    assert assign(np.full((1, 1), 100.0), np.zeros((1, 1)), np.zeros((1, 1), int)) == []


def test_no_track_gives_way_to_make_another_pair_possible() -> None:
    # the first track has nine tenths of the second body; a new one has a feature there as well,
    # and the first body is within the first track's gate
    distance = np.array([[20.0, 1.0], [500.0, 20.0]])
    share = np.array([[0.0, 0.9], [0.0, 0.1]])
    assert assign(distance, share, np.zeros((2, 2), dtype=np.int64)) == [(0, 1)]


def test_a_measurement_of_another_tracks_features_is_not_associated() -> None:
    far = make_track((30.0, 0.0, 0.0), ids=(1, 2, 3), track_id=0)
    near = make_track((0.0, 0.0, 0.0), ids=(8,), track_id=1)
    seen = measurement((0.0, 0.0, 0.0), ids=(1, 2, 3))
    in_view = np.zeros(2, dtype=np.bool_)
    now_ns = near.measured_ns + 100_000_000
    assert associate([near, far], [seen], in_view, now_ns) == {}
    assert associate([near, far], [measurement(ids=(20, 21, 22))], in_view, now_ns) == {0: 0}


def test_out_of_view_only_a_conclusive_measurement_is_associated() -> None:
    track = make_track(ids=(1, 2, 3))
    now_ns = track.measured_ns + 100_000_000
    few, many = measurement(ids=range(20, 23)), measurement(ids=range(20, 30))
    for out_of_view, seen, expected in (
        (True, few, {}),
        (True, many, {0: 0}),
        (False, few, {0: 0}),
    ):
        given = np.array([out_of_view])
        assert associate([track], [seen], given, now_ns) == expected
    assert associate([], [few], np.zeros(0, dtype=np.bool_), now_ns) == {}
