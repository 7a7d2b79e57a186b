"""Classes of motion: what sizes and speeds say, alone and together."""

import numpy as np
import pytest
from scipy.integrate import quad

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.motion_class import (
    CLASSES,
    SpeedHistory,
    class_probability,
    classified,
    history_log_likelihood,
    no_history,
    size_log_likelihood,
    speed_log_likelihood,
    with_speed,
)
from ovmot.physics import MAX_ROAD_MPS, TRIP_SHARES

PRIOR = np.array(TRIP_SHARES) / sum(TRIP_SHARES)
SHARP = np.full(3, 0.05)
FACES = np.ones((1, 3), np.bool_)


def driven(speeds: list[float], sigma: float = 0.2) -> SpeedHistory:
    history = no_history()
    for speed in speeds:
        history = with_speed(history, speed, likelihood(speed, sigma))
    return history


def likelihood(speed: float, sigma: float = 0.2) -> FloatArray:
    return np.asarray(speed_log_likelihood(np.array([speed]), np.array([sigma]))[0])


def of_size(size: FloatArray, sigma: FloatArray) -> FloatArray:
    return np.asarray(size_log_likelihood(size[None], sigma[None], FACES)[0])


def class_of(history: SpeedHistory, size: FloatArray) -> FloatArray:
    return class_probability(history_log_likelihood(history), of_size(size, SHARP))


def probability(speeds: list[float], size: tuple[float, float, float]) -> dict[str, float]:
    found = class_of(driven(speeds), np.array(size))
    return dict(zip(CLASSES, found.tolist(), strict=True))


@pytest.mark.parametrize(
    ("speeds", "size", "name"),
    [
        ([1.3] * 10, (0.5, 0.45, 1.7), "walker"),
        ([1.5] * 10, (0.7, 0.3, 1.2), "walker"),  # seen in part
        ([1.4, 1.4, 1.3, 3.0, 1.4, 1.4], (0.6, 0.5, 1.7), "walker"),  # one wrong speed
        ([4.5] * 10, (1.6, 0.5, 1.6), "cyclist"),
        ([2.5] * 10, (1.7, 0.5, 1.7), "cyclist"),
        ([9.0] * 10, (4.0, 1.7, 1.4), "vehicle"),
        ([1.3] * 20, (4.0, 1.7, 1.4), "vehicle"),  # creeps in a jam
        ([4.2] * 20, (4.0, 1.7, 1.4), "vehicle"),
        ([6.0] * 10, (11.5, 2.4, 3.0), "vehicle"),
        ([16.0] * 10, (1.0, 0.5, 1.0), "vehicle"),  # a part of one, faster than any cyclist
        ([0.1] * 10, (4.0, 1.7, 1.4), "vehicle"),
    ],
)
def test_usual_road_users(speeds: list[float], size: tuple[float, float, float], name: str) -> None:
    found = probability(speeds, size)
    assert sum(found.values()) == pytest.approx(1.0)
    assert max(found, key=lambda k: found[k]) == name
    assert found[name] > 0.6


def test_length_and_width_may_be_swapped() -> None:
    a = of_size(np.array([1.7, 0.5, 1.7]), SHARP)
    b = of_size(np.array([0.5, 1.7, 1.7]), SHARP)
    np.testing.assert_array_equal(a, b)


def test_what_is_not_known_of_the_size_says_nothing() -> None:
    found = class_of(no_history(), np.full(3, np.nan))
    np.testing.assert_allclose(found, PRIOR)


def test_of_a_side_that_no_view_shows_only_its_least_size_counts() -> None:
    """Of a car that comes into view a small part says nothing, a large one excludes walkers."""
    hidden = np.array([[False, False, True]])

    def odds(length: float, faces: BoolArray) -> float:
        size = np.array([[length, 0.4, np.nan]])
        found = size_log_likelihood(size, np.full((1, 3), 0.05), faces)[0]
        return float(found[CLASSES.index("walker")] - found[CLASSES.index("vehicle")])

    assert odds(0.5, hidden) == pytest.approx(0.0, abs=0.1)
    assert odds(0.5, FACES) > 2.0
    assert odds(3.0, hidden) < -10.0


def test_slow_speeds_say_nothing_and_a_pace_that_is_kept_is_one_observation() -> None:
    size = np.full(3, np.nan)
    np.testing.assert_allclose(class_of(driven([0.2] * 50), size), PRIOR)
    short, long = (class_of(driven([1.4] * n), size)[0] for n in (2, 60))
    assert PRIOR[0] < short
    assert long == pytest.approx(short)


@pytest.mark.parametrize("k", range(3))
def test_the_speeds_likelihood_is_a_density(k: int) -> None:
    def density(speed: float) -> float:
        return float(np.exp(likelihood(speed, 0.01)[k]))

    total = quad(density, 0.0, MAX_ROAD_MPS[k] + 1.0, points=(1.34, 4.25), limit=200)[0]
    assert total == pytest.approx(1.0, abs=0.01)


def test_many_tracks_at_once_are_each_alone() -> None:
    rng = np.random.default_rng(2)
    speed, size = rng.uniform(0.0, 20.0, 5), rng.uniform(0.2, 5.0, (5, 3))
    sigma = rng.uniform(0.05, 0.5, (5, 3))
    many = (
        speed_log_likelihood(speed, sigma[:, 0]),
        size_log_likelihood(size, sigma, np.repeat(FACES, 5, axis=0)),
    )
    for k in range(5):
        np.testing.assert_allclose(many[0][k], likelihood(float(speed[k]), float(sigma[k, 0])))
        np.testing.assert_allclose(many[1][k], of_size(size[k], sigma[k]))


def test_tracks_of_a_frame_get_their_classes_and_their_histories_go_on() -> None:
    speed, sigma = np.array([1.4, 9.0]), np.array([0.05, 0.05])
    size = np.array([[0.5, 0.4, 1.7], [4.2, 1.7, 1.4]])
    of_size = size, np.full((2, 3), 0.05), np.repeat(FACES, 2, axis=0)
    histories, named = classified([no_history()] * 2, speed, sigma, *of_size)
    assert np.argmax(named, axis=1).tolist() == [0, 2]
    later, _ = classified(histories, speed, sigma, *of_size)
    assert [history.frames for history in later] == [2, 2]
