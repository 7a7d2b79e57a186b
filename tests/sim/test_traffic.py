"""Bodies on the road: outlines that touch or not."""

import numpy as np
from outline_checks import apart, corners

from ovmot.sim.traffic import Outline, check_times, touching


def test_the_check_tells_outlines_apart() -> None:
    square = corners(np.zeros(2), 0.0, np.array([2.0, 2.0]))
    assert apart(square, square + np.array([2.1, 0.0]))
    assert not apart(square, square + np.array([1.9, 1.9]))
    turned = corners(np.array([2.3, 0.0]), 0.25 * np.pi, np.array([2.0, 2.0]))
    assert not apart(square, turned)
    assert apart(square, turned + np.array([0.2, 0.0]))


def test_touching_agrees_with_the_check() -> None:
    rng = np.random.default_rng(4)
    places, yaws = rng.uniform(-4.0, 4.0, (200, 2)), rng.uniform(-np.pi, np.pi, 200)
    still = Outline(np.zeros((200, 2)), np.zeros(200), 4.6, 1.9)
    other = Outline(places, yaws, 2.0, 1.0)
    found = touching(still, other)
    a = corners(np.zeros(2), 0.0, np.array([4.6, 1.9]))
    expected = [
        not apart(a, corners(place, float(yaw), np.array([2.0, 1.0])))
        for place, yaw in zip(places, yaws, strict=True)
    ]
    assert 20 < np.count_nonzero(found) < 180
    np.testing.assert_array_equal(found, expected)


def test_a_gap_makes_more_of_them_touch() -> None:
    xy = np.stack([np.linspace(0.0, 6.0, 50), np.zeros(50)], axis=-1)
    a = Outline(np.zeros((50, 2)), np.zeros(50), 4.0, 2.0)
    b = Outline(xy, np.zeros(50), 2.0, 2.0)
    assert touching(a, b, 0.5).sum() > touching(a, b).sum()
    np.testing.assert_array_equal(touching(a, b), xy[:, 0] <= 3.0)


def test_times_of_the_check_span_the_scene() -> None:
    times = check_times(10, 2.0)
    assert times[0] == 10
    assert times[-1] == 10 + 2_000_000_000
