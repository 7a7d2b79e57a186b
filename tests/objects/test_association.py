"""Data association: distances of single filters, gates, common features."""

from dataclasses import replace

import numpy as np
import pytest
from object_fixtures import make_track, measurement

from ovmot.objects.association import (
    assign,
    associate,
    common_features,
    mahalanobis_distances,
)
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.object_filter import Observation, distance
from ovmot.objects.track import DRIVES_MPS, as_observation, predict_track, start_track


def random_measurement(seed: int, speed: float) -> ObjectMeasurement:
    rng = np.random.default_rng(seed)
    L = 0.1 * rng.normal(0.0, 1.0, (6, 6))
    P = L @ L.T + 0.01 * np.eye(6)
    made = measurement(
        list(rng.normal(0.0, 3.0, 3)), (speed, 0.5, 0.1), (7, 3, 5),
        size=rng.uniform(0.5, 2.0, 3), span_s=0.4,
    )  # fmt: skip
    return replace(made, yaw_rate=0.1, covariance=P, scaled_covariance=P)


def test_distances_are_those_of_single_filters() -> None:
    now_ns = 200_000_000
    tracks = [
        predict_track(start_track(k, 0, random_measurement(k, v)), now_ns)
        for k, v in enumerate((1.0, 8.0, DRIVES_MPS + 0.5))
    ]
    seen = [random_measurement(10, 8.2), replace(random_measurement(11, 1.0), span_s=0.1)]
    found = mahalanobis_distances(tracks, seen, now_ns)
    for i, track in enumerate(tracks):
        for j, m in enumerate(seen):
            size = np.maximum(track.size, m.size)
            whole = as_observation(m, size, 0.2)
            R = whole.covariance[:6, :6].copy()
            if np.hypot(*track.velocity[:2]) > DRIVES_MPS:  # its other end may be seen
                along = track.velocity / np.hypot(*track.velocity[:2])
                R[:3, :3] += (0.25 * (4.5 - size[0])) ** 2 * np.outer(along, along)
            six = Observation(whole.H[:6], whole.value[:6], R)
            assert found[i, j] == pytest.approx(distance(track.filter, six), rel=1e-9)


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
