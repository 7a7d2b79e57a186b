"""The log-ratio by which a body moves: its rates of error, and what lenses and slides leave."""

import math

import numpy as np
import pytest
from object_fixtures import FRAME_NS, T_WORLD_CAM0, frame_of, make_body, scene_points
from scipy.stats import multivariate_normal

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.motion_evidence import (
    Origin,
    against_slides,
    body_log_ratio,
    carried_origin,
    lens_doubt,
    log_ratios,
)
from ovmot.physics import LEAST_MATCH_SIGMA_PX, LENS_SCALE_SIGMA, LENS_SIGMA_PX, SLIDE_SHARE
from ovmot.settings import ObjectTrackSettings

SETTINGS = ObjectTrackSettings()
BOUND = math.log((1.0 - SETTINGS.miss) / SETTINGS.false_alarm)
FOCAL_BASELINE = 400.0 * 0.47


def log_ratio(way: FloatArray, C: FloatArray, seconds: float) -> float:
    """That of one way."""
    return float(log_ratios(way[None], C[None], np.array([seconds]))[0])


def test_the_ratio_is_that_of_rest_and_of_the_classes() -> None:
    way, C, seconds = np.array([2.0, -0.4, 0.1]), np.diag([0.3, 0.02, 0.01]), 0.7
    level = [math.hypot(1.34, 0.26) / 2**0.5, math.hypot(4.25, 1.2) / 2**0.5, 10.0]
    moving = [
        multivariate_normal(
            cov=C + np.diag(np.square([s * seconds, s * seconds, 0.05 * s * seconds]))
        ).pdf(way)
        for s in level
    ]
    at_rest = multivariate_normal(cov=C).logpdf(way)
    expected = math.log(np.mean(moving)) - at_rest
    assert log_ratio(way, C, seconds) == pytest.approx(expected)
    assert log_ratio(way, C, 0.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sigma_m", [(0.05, 0.05, 0.02), (2.0, 0.2, 0.05)])
def test_rest_is_taken_for_motion_no_more_often_than_said(
    sigma_m: tuple[float, float, float],
) -> None:
    """Once, and ever in two seconds of views whose errors add up to those of the way."""
    rng, alpha, runs = np.random.default_rng(0), 0.02, 4000
    C = np.diag(np.square(sigma_m))
    once = [log_ratio(e, C, 1.0) for e in rng.multivariate_normal(np.zeros(3), C, runs)]
    assert np.mean(np.array(once) > -math.log(alpha)) <= alpha
    ever = 0
    for _ in range(runs // 10):
        steps = rng.multivariate_normal(np.zeros(3), C, 20)
        means = np.cumsum(steps, axis=0) / np.arange(1, 21)[:, None]
        ever += any(log_ratio(m, C / n, 1.0) > -math.log(alpha) for n, m in enumerate(means, 1))
    assert ever <= 2.0 * alpha * runs // 10


@pytest.mark.parametrize(
    ("sigma_m", "speed"), [((0.1, 0.05, 0.02), 1.34), ((0.5, 0.1, 0.05), 4.0), ((1.0, 0.2, 0.1), 9)]
)
def test_who_moves_is_found_and_hardly_ever_dropped(
    sigma_m: tuple[float, float, float], speed: float
) -> None:
    rng, C, seconds = np.random.default_rng(1), np.diag(np.square(sigma_m)), 1.0
    angle = rng.uniform(-np.pi, np.pi, 1000)
    way = seconds * speed * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    way = way + rng.multivariate_normal(np.zeros(3), C, len(way))
    ratio = np.array([log_ratio(w, C, seconds) for w in way])
    assert np.mean(ratio > BOUND) > 0.95
    assert np.mean(ratio < math.log(SETTINGS.miss)) <= 1e-2


def test_patches_that_slide_together_are_taken_for_a_body_no_more_often_than_said() -> None:
    """Of pairs of patches a share slides together; each further one slides with them with that
    share, and the drift goes on in its quadrant with a quarter."""
    rng, n = np.random.default_rng(2), 200_000
    n_features = 1 + rng.geometric(1.0 - SLIDE_SHARE, n)
    again = rng.geometric(0.75, n) - 1
    kinds, counts = np.unique(np.stack([n_features, again], axis=1), axis=0, return_counts=True)
    sure = [against_slides(50.0, 50.0, 50.0, int(k), int(a)) > BOUND for k, a in kinds]
    assert 0 < SLIDE_SHARE * counts[sure].sum() <= SETTINGS.false_alarm * n
    assert against_slides(50.0, 50.0, -2.0, 3, 9) < 2.0  # slid once, and rests


@pytest.mark.parametrize(
    ("n_features", "again", "sure"),
    [(2, 3, False), (2, 4, True), (3, 1, False), (3, 2, True), (4, 0, True)],
)
def test_few_features_must_be_found_again(n_features: int, again: int, sure: bool) -> None:
    assert (against_slides(100.0, 100.0, 100.0, n_features, again) > BOUND) is sure
    assert against_slides(3.0, 100.0, 100.0, n_features, 9) == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    ("n_features", "again", "sure"), [(4, 0, False), (4, 2, False), (4, 3, True), (8, 0, True)]
)
def test_a_way_along_the_ray_alone_may_be_a_slide_in_depth(
    n_features: int, again: int, sure: bool
) -> None:
    """What lies on one edge, or on one texture that repeats itself: more features must show it."""
    assert (against_slides(100.0, -3.0, 100.0, n_features, again) > BOUND) is sure


def test_a_way_along_the_ray_says_nothing_across_it() -> None:
    """Nor does a way across it lose anything by what is not known along it."""
    ray = np.array([0.8, 0.6, 0.0])
    C, unknown = 0.01 * np.eye(3), 1e6 * np.outer(ray, ray)
    along = log_ratio(3.0 * ray, C + unknown, 1.0)
    across = log_ratio(np.array([-1.8, 2.4, 0.0]), C + unknown, 1.0)
    assert along < 0.0 < BOUND < across


def test_where_the_image_stands_lenses_err_alike_at_both_ends() -> None:
    """From a rig that stands: no error of a lens moves what rests, but those of matches do."""
    frame, place = frame_of(scene_points([]), FRAME_NS), np.array([14.0, 0.0, 1.6])
    origin = Origin(0, place, T_WORLD_CAM0)
    per_px = 14.0**2 / FOCAL_BASELINE
    expected = 2.0 * np.diag([(LEAST_MATCH_SIGMA_PX * per_px) ** 2, 0.0, 0.0])
    np.testing.assert_allclose(lens_doubt(place, origin, frame), expected, atol=1e-12)


def test_past_other_places_of_the_image_lenses_err_at_both_ends() -> None:
    """Four pixels aside they have nothing in common: the disparity is off at each end."""
    frame, place = frame_of(scene_points([]), FRAME_NS), np.array([14.0, 0.0, 1.6])
    moved = T_WORLD_CAM0.copy()
    moved[1, 3] = 0.5  # 14 px
    doubt = lens_doubt(place, Origin(0, place, moved), frame)
    per_px = 14.0**2 / FOCAL_BASELINE
    along = 2.0 * (2.0 * LENS_SIGMA_PX**2 + LEAST_MATCH_SIGMA_PX**2) * per_px**2
    assert doubt[0, 0] == pytest.approx(along, rel=0.01)
    assert doubt[2, 2] == pytest.approx(0.0, abs=1e-12)


def test_a_turning_rig_leaves_more_in_doubt_across_the_ray() -> None:
    """In a corner of the picture a lens may be off by a tenth of the way that it sees pass."""
    frame, place, angle = frame_of(scene_points([]), FRAME_NS), np.array([14.0, 0.0, 1.6]), 0.15
    turned = se3.make(rotation_z(angle) @ T_WORLD_CAM0[:3, :3], T_WORLD_CAM0[:3, 3])
    doubt = lens_doubt(place, Origin(0, place, turned), frame)
    np.testing.assert_allclose(np.diag(doubt)[1:], (LENS_SCALE_SIGMA * angle * 14.0) ** 2)


@pytest.mark.parametrize(
    ("way", "sure"),
    [
        ((1.0, 0.0, 0.0), False),  # half a pixel of disparity at 14 m
        ((0.0, 1.0, 0.0), True),
        ((3.0, 0.0, 0.0), True),
    ],
)
def test_a_way_along_the_ray_must_be_more_than_lenses_err(
    way: tuple[float, float, float], sure: bool
) -> None:
    """By a rig that drives past: many features know a way no better than one."""
    place = np.array([14.0, 0.0, 1.6])
    frame = frame_of(scene_points([]), FRAME_NS)
    moved = T_WORLD_CAM0.copy()
    moved[1, 3] = 0.5
    origin = Origin(frame.timestamp_ns - 300_000_000, place - np.array(way), moved)
    body = make_body(tuple(place), tuple(np.array(way) / 0.3))._replace(n_used=9)
    assert (body_log_ratio(body, origin, frame, 9, 2) > BOUND) is sure
    assert body_log_ratio(body, origin._replace(timestamp_ns=FRAME_NS), frame, 9, 2) == 0.0


def test_an_origin_goes_with_the_world() -> None:
    T = se3.make(rotation_z(0.1), np.array([0.2, -0.1, 0.05]))
    origin = Origin(5, np.array([10.0, 2.0, 1.0]), T_WORLD_CAM0)
    moved = carried_origin(origin, T)
    np.testing.assert_allclose(
        se3.apply(se3.inverse(moved.T_world_cam0), moved.place),
        se3.apply(se3.inverse(origin.T_world_cam0), origin.place),
    )
    assert moved.timestamp_ns == 5
