"""One track: how it starts, is predicted and updated, and with which noise."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.track import (
    TrackState,
    as_observation,
    centre_sigma,
    correlated_count,
    horizontal_variance,
    predict_track,
    start_track,
    update_track,
)
from ovmot.settings import ObjectTrackSettings


def measurement(seed: int, speed: float) -> ObjectMeasurement:
    rng = np.random.default_rng(seed)
    L = 0.1 * rng.normal(0.0, 1.0, (6, 6))
    position, P = rng.normal(0.0, 3.0, 3), L @ L.T + 0.01 * np.eye(6)
    return ObjectMeasurement(
        feature_id=np.array([7, 3, 5]), p_world=position + np.eye(3), position=position,
        velocity=np.array([speed, 0.5, 0.1]), yaw_rate=0.1, T_now_before=np.eye(4), span_s=0.4,
        covariance=P, scaled_covariance=P, yaw_rate_variance=0.01,
        size=rng.uniform(0.5, 2.0, 3),
    )  # fmt: skip


def crossing(n: int, velocity: list[float], sigma: list[float]) -> ObjectMeasurement:
    P = np.diag(np.concatenate([[0.1, 0.1, 0.1], sigma]) ** 2)
    return replace(
        measurement(0, 1.0),
        feature_id=np.arange(n),
        velocity=np.array(velocity),
        covariance=P,
        scaled_covariance=P,
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


def test_a_measurement_enters_with_the_scaled_noise() -> None:
    m = measurement(1, 3.0)
    prior, scaled = (
        as_observation(x, m.size, None)
        for x in (m, replace(m, scaled_covariance=0.5 * m.covariance))
    )
    np.testing.assert_allclose(scaled.covariance[3:6, 3:6], 0.5 * prior.covariance[3:6, 3:6])


def test_measurements_of_one_span_are_correlated() -> None:
    m = measurement(1, 3.0)  # over 0.4 s
    alone, fourth = (as_observation(m, m.size, dt_s) for dt_s in (None, 0.1))
    np.testing.assert_allclose(fourth.covariance, 4.0 * alone.covariance)
    np.testing.assert_array_equal(correlated_count(np.array([0.4, 0.1]), np.array(0.2)), [2.0, 1.0])


def test_the_centre_is_as_unsure_as_the_body_is_large() -> None:
    sizes = np.array([[4.0, 1.8, 1.5], [0.4, 0.4, 0.4]])
    np.testing.assert_allclose(centre_sigma(sizes), [1.0, 0.2])


def test_an_update_confirms_and_a_prediction_widens() -> None:
    settings, frame_ns = ObjectTrackSettings(), 100_000_000
    m = replace(measurement(2, 3.0), feature_id=np.array([1, 2, 3]))
    track = start_track(4, 0, m)
    for k in range(1, 4):
        track = predict_track(track, k * frame_ns)
        moved = replace(m, position=m.position + 0.1 * k * m.velocity, feature_id=np.array([3, 9]))
        track = update_track(track, moved, k * frame_ns, settings)
    assert (track.state, track.hits) == (TrackState.CONFIRMED, 4)
    assert track.feature_id.tolist() == [1, 2, 3, 9]
    np.testing.assert_allclose(track.position, moved.position)
    later = predict_track(track, 10 * frame_ns)
    assert horizontal_variance(later) > horizontal_variance(track)
    np.testing.assert_allclose(later.position - track.position, 0.7 * track.velocity, atol=1e-9)
