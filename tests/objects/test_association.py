"""Data association: distances, gates, common features."""

import numpy as np
import pytest
from object_fixtures import make_track, measurement
from scipy.stats import multivariate_normal

from ovmot.objects.association import (
    assign,
    associate,
    common_features,
    log_density_of_new,
)
from ovmot.objects.track import TrackState
from ovmot.physics import ROAD_SPEED_SIGMA_MPS, ROAD_USER_AREA_M2


@pytest.mark.parametrize("sigma_mps", [0.1, 2.0])
def test_a_new_road_user_may_be_anywhere_at_road_users_velocities(sigma_mps: float) -> None:
    seen = measurement((1.0, 0.0, 0.0), (4.0, 0.0, 0.0), sigma=sigma_mps)
    road = np.square(ROAD_SPEED_SIGMA_MPS[:2]) + sigma_mps**2
    velocity = multivariate_normal(cov=np.diag(road)).logpdf([4.0, 0.0])
    expected = np.log(0.1 / ROAD_USER_AREA_M2) + velocity
    np.testing.assert_allclose(log_density_of_new([seen, seen]), expected)


@pytest.mark.parametrize(("sigma_m", "found"), [(0.5, True), (20.0, False)])
def test_a_lost_track_is_found_by_what_is_rather_its_own_than_a_new_ones(
    sigma_m: float, found: bool
) -> None:
    """A place that is hardly known tells no old body from a new one."""
    track = make_track(state=TrackState.COASTING)
    P = np.diag(np.repeat([sigma_m, 0.5 * sigma_m], 3) ** 2)
    track = track._replace(box=track.box._replace(covariance=P))
    seen = measurement((0.5, 0.2, 0.0), (3.1, 0.0, 0.0), ids=(50, 51))
    now_ns = track.measured_ns + 500_000_000
    pairs = associate([track], [seen], now_ns)
    assert pairs == ({0: 0} if found else {})


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
    now_ns = near.measured_ns + 100_000_000
    assert associate([near, far], [seen], now_ns) == {}
    assert associate([near, far], [measurement(ids=(20, 21, 22))], now_ns) == {0: 0}
