"""Distances of all tracks to all measurements at once are those of one filter and one of them."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.object_filter import Observation, distance
from ovmot.objects.track import (
    DRIVES_MPS,
    TrackState,
    as_observation,
    carried,
    gaps,
    start_track,
)
from ovmot.settings import ObjectTrackSettings


def measurement(seed: int, speed: float) -> ObjectMeasurement:
    rng = np.random.default_rng(seed)
    L = 0.1 * rng.normal(0.0, 1.0, (6, 6))
    position = rng.normal(0.0, 3.0, 3)
    return ObjectMeasurement(
        feature_id=np.array([7, 3, 5]), p_world=position + np.eye(3), position=position,
        velocity=np.array([speed, 0.5, 0.1]), yaw_rate=0.1, T_now_before=np.eye(4), span_s=0.4,
        covariance=L @ L.T + 0.01 * np.eye(6), excess=np.zeros((6, 6)), yaw_rate_variance=0.01,
        size=rng.uniform(0.5, 2.0, 3),
    )  # fmt: skip


def crossing(n: int, velocity: list[float], sigma: list[float]) -> ObjectMeasurement:
    P = np.diag(np.concatenate([[0.1, 0.1, 0.1], sigma]) ** 2)
    return replace(
        measurement(0, 1.0), feature_id=np.arange(n), velocity=np.array(velocity), covariance=P
    )


@pytest.mark.parametrize(
    ("n", "velocity", "state"),
    [
        (5, [1.0, 5.0, 0.0], TrackState.CONFIRMED),
        (4, [1.0, 5.0, 0.0], TrackState.TENTATIVE),  # few
        (9, [1.0, 0.9, 0.0], TrackState.TENTATIVE),  # not sure
        (9, [12.0, 5.0, 0.0], TrackState.TENTATIVE),  # along the ray: patches that slide
    ],
)
def test_one_measurement_of_many_features_that_surely_cross_is_enough(
    n: int, velocity: list[float], state: TrackState
) -> None:
    assert start_track(0, 0, crossing(n, velocity, [1.0, 0.2, 0.2])).state == state


def test_what_is_not_known_of_a_velocity_is_that_of_road_users() -> None:
    far = start_track(0, 0, crossing(5, [40.0, 5.0, 0.0], [20.0, 0.2, 0.2]))
    assert far.velocity[0] == pytest.approx(40.0 / (1.0 + (20.0 / 10.0) ** 2))
    assert far.velocity[1] == pytest.approx(5.0, rel=1e-3)


def test_noise_that_does_not_show_is_not_claimed() -> None:
    m = measurement(1, 3.0)
    told, shown = (
        as_observation(x, m.size, None) for x in (m, replace(m, excess=0.5 * m.covariance))
    )
    np.testing.assert_allclose(shown.covariance[3:6, 3:6], 0.5 * told.covariance[3:6, 3:6])


def test_gaps_are_the_distances_of_single_filters() -> None:
    now_ns = 200_000_000
    tracks = [
        carried(start_track(k, 0, measurement(k, v)), now_ns, ObjectTrackSettings())
        for k, v in enumerate((1.0, 8.0, DRIVES_MPS + 0.5))
    ]
    seen = [measurement(10, 8.2), replace(measurement(11, 1.0), span_s=0.1)]
    found = gaps(tracks, seen, now_ns)
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
