"""Labels of points: what their track does, where that is clear; else unknown."""

from collections.abc import Sequence

import numpy as np
import pytest
from object_fixtures import feature_motions, make_track, scene_points

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.point_labels import Speeds, label_points, speeds_of
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_features import hulls_of
from ovmot.types import PointLabel, ScenePoints

UNKNOWN, STATIC, DYNAMIC = (int(k) for k in PointLabel)
NOTHING_BEFORE = speeds_of(())


def track(
    velocity: FloatArray, sigma: float = 0.1, state: TrackState = TrackState.CONFIRMED
) -> Track:
    return make_track(velocity=list(velocity), state=state, sigma=sigma)


def seen(label: int, n: int = 1) -> ScenePoints:
    return scene_points([label] * n)


def motions(velocity: FloatArray, x_m: float = 0.0) -> FeatureMotions:
    """Features with velocities (N, 3), known to 0.3 m/s, ahead of the track's centre."""
    return feature_motions(velocity, np.tile([x_m, 0.0, 0.0], (len(velocity), 1)))


def labelled(
    points: ScenePoints, owner: IntArray, tracks: Sequence[Track], moving: FeatureMotions,
    before: Speeds,
) -> ScenePoints:  # fmt: skip
    return label_points(points, owner, tracks, hulls_of(tracks), moving, before)


def label_of(body: Track, before: Speeds = NOTHING_BEFORE, segmented: int = STATIC) -> int:
    """The label of a point that goes as its track does."""
    points = labelled(seen(segmented), np.array([0]), [body], motions(body.velocity[None]), before)
    return int(points.label[0])


@pytest.mark.parametrize(
    ("speed", "sigma", "label"),
    [
        (3.0, 0.3, DYNAMIC),
        (1.1, 0.1, DYNAMIC),
        (1.02, 0.1, UNKNOWN),
        (0.98, 0.1, UNKNOWN),
        (0.9, 0.1, STATIC),
        (1.1, 0.5, UNKNOWN),
        (0.0, 0.4, STATIC),
    ],
)
def test_a_point_does_what_its_track_does(speed: float, sigma: float, label: int) -> None:
    assert label_of(track(np.array([0.0, speed, 0.0]), sigma)) == label
    assert label_of(track(np.array([0.0, speed, 0.0]), sigma), segmented=DYNAMIC) == label


@pytest.mark.parametrize(("before", "label"), [(1.6, STATIC), (1.4, UNKNOWN), (1.23, DYNAMIC)])
def test_on_the_brakes_the_next_speed_counts(before: float, label: int) -> None:
    """0.4 m/s a frame carry 1.2 m/s on to less than 1 m/s; noise does not."""
    body = track(np.array([1.2, 0.0, 0.0]))
    assert label_of(body, Speeds(np.array([3, 7]), np.array([9.0, before]))) == label
    other = Speeds(np.array([3, 8]), np.array([9.0, before]))
    assert label_of(body, other) == DYNAMIC


def test_pulling_out_too() -> None:
    body = track(np.array([0.9, 0.0, 0.0]))
    assert label_of(body) == STATIC
    assert label_of(body, Speeds(np.array([7]), np.array([0.6]))) == DYNAMIC


def test_beside_a_body_points_rest() -> None:
    """Of a moving track's points those that clearly rest are static, those that may, unknown."""
    body = track(np.array([2.0, 0.0, 0.0]))
    v = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [np.nan] * 3])
    owner = np.zeros(4, np.int64)
    points = labelled(seen(DYNAMIC, 4), owner, [body], motions(v), NOTHING_BEFORE)
    assert points.label.tolist() == [DYNAMIC, STATIC, UNKNOWN, DYNAMIC]
    np.testing.assert_array_equal(points.track_id, owner + 7)


@pytest.mark.parametrize(("x_m", "label"), [(1.0, UNKNOWN), (9.0, STATIC)])
def test_where_a_body_moves_rest_must_be_seen(x_m: float, label: int) -> None:
    """A point segmented as static, and is no track's, may be a part of the body."""
    body = track(np.array([2.0, 0.0, 0.0]))
    v = np.array([[1.9, 0.0, 0.0], [0.2, 0.0, 0.0], [np.nan] * 3])
    arguments = np.full(3, -1), [body], motions(v, x_m), NOTHING_BEFORE
    points = labelled(seen(STATIC, 3), *arguments)
    assert points.label.tolist() == [label, STATIC, STATIC]
    standing = track(np.zeros(3))
    arguments = np.full(3, -1), [standing], motions(v, x_m), NOTHING_BEFORE
    points = labelled(seen(STATIC, 3), *arguments)
    assert points.label.tolist() == [STATIC] * 3


def test_what_moves_alone_is_unknown() -> None:
    owner: IntArray = np.array([-1, 0])
    tentative = track(np.array([2.0, 0.0, 0.0]), state=TrackState.TENTATIVE)
    arguments = owner, [tentative], motions(np.zeros((2, 3))), NOTHING_BEFORE
    assert labelled(seen(DYNAMIC, 2), *arguments).label.tolist() == [UNKNOWN, DYNAMIC]
    assert labelled(seen(STATIC, 2), *arguments).label.tolist() == [STATIC, STATIC]


def test_speeds_are_in_the_order_of_ids() -> None:
    bodies = [
        track(np.array([3.0, 4.0, 0.0]))._replace(track_id=9),
        track(np.array([0.0, 1.0, 0.0])),
    ]
    speeds = speeds_of(bodies)
    assert speeds.track_id.tolist() == [7, 9]
    np.testing.assert_allclose(speeds.speed, [1.0, 5.0], rtol=1e-3)
