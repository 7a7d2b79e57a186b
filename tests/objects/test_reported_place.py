"""The reported centre: smooth where the estimated one is corrected to and fro, and near it."""

from itertools import pairwise

import numpy as np
import pytest
from object_fixtures import make_track

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_box_kernel import Box
from ovmot.objects.reported_place import AT_ITS_PLACE, centre_sigma, lag_after

DT, V = 0.1, np.array([3.0, 0.0, 0.0])


def box_at(centre: FloatArray) -> Box:
    return make_track((0.0, 0.0, 1.0)).box._replace(centre=centre, velocity=V)


def ways(errors: FloatArray, smoothing_s: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Estimated and reported centres (n, 3) of a body at 3 m/s, whose estimate has `errors` (n,)
    along its way."""
    boxes = [box_at((k * DT + error / 3.0) * V) for k, error in enumerate(errors)]
    lag, reported = AT_ITS_PLACE, [boxes[0].centre]
    for old, new in pairwise(boxes):
        lag = lag_after(lag, old, new, DT, smoothing_s)
        reported.append(new.centre + lag)
    return np.array([box.centre for box in boxes]), np.array(reported)


def roughness(way: FloatArray) -> float:
    return float(np.abs(np.diff(way[:, 0], 2)).max())


def test_what_goes_steadily_is_reported_where_it_is() -> None:
    estimated, reported = ways(np.zeros(20))
    np.testing.assert_allclose(reported, estimated, atol=1e-12)


def test_corrections_to_and_fro_do_not_shake_the_trail() -> None:
    estimated, reported = ways(0.05 * np.where(np.arange(40) % 2, 1.0, -1.0))
    assert roughness(reported[5:]) < 0.3 * roughness(estimated[5:])


def test_a_step_is_followed() -> None:
    step = np.where(np.arange(40) < 10, 0.0, 0.1)
    estimated, reported = ways(step)
    behind = estimated[:, 0] - reported[:, 0]
    assert behind[10] == pytest.approx(0.1 * np.exp(-DT / 0.5))
    assert np.all(np.diff(behind[10:]) < 0.0)
    assert behind[-1] < 0.01 * behind[10]


def test_the_reported_centre_stays_where_the_body_may_be() -> None:
    estimated, reported = ways(np.where(np.arange(12) < 10, 0.0, 30.0))
    bound = 1.96 * centre_sigma(box_at(np.zeros(3)))
    assert np.all(np.abs(estimated - reported) <= bound + 1e-3)


def test_without_smoothing_the_estimated_centre_is_reported() -> None:
    estimated, reported = ways(np.random.default_rng(0).normal(size=20), smoothing_s=0.0)
    np.testing.assert_array_equal(reported, estimated)
