"""Labels of points: what their track does, where that is clear; else unknown."""

from dataclasses import replace

import numpy as np
import pytest
from object_fixtures import FRAME_NS, feature_motions, make_track, scene_points
from scipy.stats import multivariate_normal

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.point_labels import Speeds, label_points, speeds_of, velocity_labels
from ovmot.objects.track import Track, TrackState
from ovmot.types import PointLabel, ScenePoints

UNKNOWN, STATIC, DYNAMIC = (int(k) for k in PointLabel)
REST_MPS = 0.15
NOTHING_BEFORE = speeds_of(0, ())


def track(
    velocity: FloatArray, sigma: float = 0.1, state: TrackState = TrackState.CONFIRMED
) -> Track:
    return make_track(velocity=list(velocity), state=state, sigma=sigma)


def seen(label: int, n: int = 1) -> ScenePoints:
    return scene_points([label] * n)


def motions(velocity: FloatArray, x_m: float = 0.0) -> FeatureMotions:
    """Features with velocities (N, 3), known to 0.3 m/s, ahead of the track's centre."""
    return feature_motions(velocity, np.tile([x_m, 0.0, 0.0], (len(velocity), 1)))


def label_of(body: Track, before: Speeds = NOTHING_BEFORE, segmented: int = STATIC) -> int:
    """The label of a point with its track's velocity."""
    given = motions(body.velocity[None])
    points = label_points(FRAME_NS, seen(segmented), np.array([7]), [body], given, before, REST_MPS)
    return int(points.label[0])


@pytest.mark.parametrize(
    ("speed", "sigma", "label"),
    [
        (3.0, 0.3, DYNAMIC),
        (1.2, 0.05, DYNAMIC),  # a slow walker, clearly measured
        (1.3, 0.25, UNKNOWN),
        (0.85, 0.05, UNKNOWN),
        (0.5, 0.05, STATIC),
        (0.0, 0.4, STATIC),
    ],
)
def test_a_point_does_what_its_track_does(speed: float, sigma: float, label: int) -> None:
    body = track(np.array([0.0, speed, 0.0]), sigma)
    assert label_of(body) == label
    assert label_of(body, segmented=DYNAMIC) == label


def test_the_speed_is_extrapolated_over_the_lag() -> None:
    body = track(np.array([1.0, 0.0, 0.0]), 0.05)
    assert label_of(body) == DYNAMIC
    braking, other = (Speeds(0, np.array([3, k]), np.array([9.0, 1.5])) for k in (7, 8))
    assert label_of(body, braking) == STATIC  # by 4.5 m/s² to 0.55 m/s
    assert label_of(body, other) == DYNAMIC
    noise = Speeds(0, np.array([7]), np.array([1.04]))
    assert label_of(body, noise) == DYNAMIC
    pulling_out = Speeds(0, np.array([7]), np.array([0.3]))
    assert label_of(track(np.array([0.7, 0.0, 0.0]), 0.05), pulling_out) == DYNAMIC


def test_a_label_is_the_ratio_of_two_likelihoods() -> None:
    v, P = np.array([0.6, -0.3, 0.05]), np.diag([0.02, 0.03, 0.01])
    lag = 0.15**2 * np.eye(3)
    rest = multivariate_normal(np.zeros(3), P + lag + 0.15**2 * np.eye(3))
    motion = multivariate_normal(np.zeros(3), P + lag + np.diag([100.0, 100.0, 0.25]))
    scaled = np.linspace(0.0, 4.0, 30)[:, None] * v
    ratio = motion.logpdf(scaled) - rest.logpdf(scaled)
    expected = np.where(ratio > 0.0, DYNAMIC, STATIC)
    expected[np.abs(ratio) < 0.5 * np.log(10.0)] = UNKNOWN
    labels = velocity_labels(scaled, np.broadcast_to(P, (30, 3, 3)), REST_MPS)
    np.testing.assert_array_equal(labels, expected)
    assert set(labels.tolist()) == {UNKNOWN, STATIC, DYNAMIC}
    nothing_known = 900.0 * np.eye(3)[None]
    assert velocity_labels(v[None], nothing_known, REST_MPS).tolist() == [UNKNOWN]


def test_beside_a_body_points_rest() -> None:
    """Of a moving track's points those that clearly rest are static, those that may, unknown."""
    body = track(np.array([2.0, 0.0, 0.0]))
    v = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [np.nan] * 3])
    owner = np.full(4, 7)
    points = label_points(
        FRAME_NS, seen(DYNAMIC, 4), owner, [body], motions(v), NOTHING_BEFORE, REST_MPS
    )
    assert points.label.tolist() == [DYNAMIC, STATIC, UNKNOWN, DYNAMIC]
    np.testing.assert_array_equal(points.track_id, owner)


@pytest.mark.parametrize(("x_m", "label"), [(1.0, UNKNOWN), (9.0, STATIC)])
def test_where_a_body_moves_rest_must_be_seen(x_m: float, label: int) -> None:
    """A point segmented as static, and is no track's, may be a part of the body."""
    body = track(np.array([2.0, 0.0, 0.0]))
    v = np.array([[1.9, 0.0, 0.0], [0.2, 0.0, 0.0], [np.nan] * 3])
    arguments = np.full(3, -1), [body], motions(v, x_m), NOTHING_BEFORE, REST_MPS
    points = label_points(FRAME_NS, seen(STATIC, 3), *arguments)
    assert points.label.tolist() == [label, STATIC, STATIC]
    standing = replace(body, filter=track(np.zeros(3)).filter)
    arguments = np.full(3, -1), [standing], motions(v, x_m), NOTHING_BEFORE, REST_MPS
    points = label_points(FRAME_NS, seen(STATIC, 3), *arguments)
    assert points.label.tolist() == [STATIC] * 3


def test_what_moves_alone_is_unknown() -> None:
    owner: IntArray = np.array([-1, 7])
    tentative = track(np.array([2.0, 0.0, 0.0]), state=TrackState.TENTATIVE)
    arguments = owner, [tentative], motions(np.zeros((2, 3))), NOTHING_BEFORE, REST_MPS
    assert label_points(FRAME_NS, seen(DYNAMIC, 2), *arguments).label.tolist() == [UNKNOWN, DYNAMIC]
    assert label_points(FRAME_NS, seen(STATIC, 2), *arguments).label.tolist() == [STATIC, STATIC]


def test_speeds_are_in_the_order_of_ids() -> None:
    bodies = [
        replace(track(np.array([3.0, 4.0, 0.0])), track_id=9),
        track(np.array([0.0, 1.0, 0.0])),
    ]
    speeds = speeds_of(5, bodies)
    assert speeds.track_id.tolist() == [7, 9]
    np.testing.assert_allclose(speeds.speed, [1.0, 5.0], rtol=1e-3)
