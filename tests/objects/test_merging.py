"""Duplicates of a body are merged; bodies that move alike are not."""

import numpy as np
import pytest
from object_fixtures import FRAME_NS, make_track

from ovmot.objects.body_kernel import BodyState
from ovmot.objects.merging import BESIDE_NS, merge_duplicates
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_features import hulls_of


def merged(tracks: tuple[Track, ...]) -> tuple[Track, ...]:
    return merge_duplicates(tracks, hulls_of(tracks))


def ids_after(tracks: tuple[Track, ...], frames: int = 5) -> list[int]:
    for _ in range(frames):
        tracks = merged(tracks)
    return [track.track_id for track in tracks]


def test_a_duplicate_is_merged_after_some_frames() -> None:
    old = make_track(ids=(1, 2, 3), track_id=0)
    new = make_track((0.8, 0.0, 0.0), ids=(7, 8, 9, 10), track_id=1)
    assert ids_after((old, new), 2) == [0, 1]
    assert ids_after((old, new), 3) == [0]
    (one,) = merged((old, new._replace(overlaps=2)))
    assert one.feature_id.tolist() == [7, 8, 9, 10]
    np.testing.assert_array_equal(one.position, new.position)  # it has more features


def test_a_young_duplicate_is_not_confirmed() -> None:
    old = make_track(ids=range(10), track_id=0)
    young = make_track((0.5, 0.0, 0.0), ids=(20,), track_id=1)
    _, kept = merged((old, young))
    assert (kept.state, kept.overlaps) == (TrackState.TENTATIVE, 1)


def test_the_count_of_overlaps_goes_down_apart() -> None:
    old = make_track(track_id=0)
    far = make_track((0.0, 9.0, 0.0), track_id=1)._replace(overlaps=2)
    assert merged((old, far))[1].overlaps == 1


def test_bodies_side_by_side_or_at_other_speeds_stay_two() -> None:
    one = make_track(ids=(1, 2, 3), track_id=0)
    assert ids_after((one, make_track((0.0, 3.4, 0.0), ids=(7, 8, 9), track_id=1))) == [0, 1]
    faster = make_track((2.5, 0.0, 0.0), (6.0, 0.0, 0.0), ids=(7, 8, 9), track_id=1)
    assert ids_after((one, faster)) == [0, 1]


def test_two_ends_of_a_lorry_are_one_body_and_two_cars_in_a_queue_are_two() -> None:
    """A lorry has a gap without features; between two cars there is more."""
    lorry = make_track(ids=range(9), track_id=0, size=np.array([5.0, 2.4, 3.0]))
    end = make_track((6.0, 0.0, 0.0), ids=(90, 91), track_id=1, size=np.array([3.0, 2.4, 3.0]))
    assert ids_after((lorry, end)) == [0]
    queue = make_track((8.0, 0.0, 0.0), ids=(90, 91), track_id=1)
    assert ids_after((make_track(track_id=0), queue)) == [0, 1]


@pytest.mark.parametrize(("speed", "ids"), [(6.0, [0]), (1.0, [0, 1])])
def test_no_vehicle_follows_another_as_near_as_parts_of_a_lorry_are(
    speed: float, ids: list[int]
) -> None:
    """Seen side by side for a second, 2 m apart: at 6 m/s no headway, in a jam two vehicles."""
    v = (speed, 0.0, 0.0)
    lorry = make_track((0.0, 0.0, 0.0), v, range(9), 0, size=np.array([5.0, 2.4, 3.0]))
    end = make_track((6.0, 0.0, 0.0), v, (90, 91), 1, size=np.array([3.0, 2.4, 3.0]))
    seen_ns = lorry.updated_ns + 2 * BESIDE_NS
    assert ids_after((lorry._replace(updated_ns=seen_ns), end._replace(updated_ns=seen_ns))) == ids


def test_what_has_room_in_one_car_is_one_body() -> None:
    """A car that comes into view shows first some parts, far from each other."""
    size, velocity = np.array([0.5, 1.3, 1.0]), (8.0, 0.0, 0.0)
    front = make_track(velocity=velocity, ids=range(9), track_id=0, size=size)
    rear = make_track((-3.8, 0.0, 0.0), velocity, ids=(90, 91), track_id=1, size=size)
    assert ids_after((front, rear)) == [0]
    behind = make_track((-4.4, 0.0, 0.0), velocity, ids=(90, 91), track_id=1, size=size)
    assert ids_after((front, behind)) == [0, 1]


def test_walkers_arm_in_arm_stay_two() -> None:
    size, velocity = np.array([0.4, 0.5, 1.7]), (0.0, 1.4, 0.0)
    one = make_track(velocity=velocity, ids=(1, 2, 3), track_id=0, size=size)
    other = make_track((0.6, 0.0, 0.0), velocity, ids=(7, 8, 9), track_id=1, size=size)
    assert ids_after((one, other)) == [0, 1]


def test_what_was_seen_side_by_side_is_two_bodies() -> None:
    """Even where the gap is small; but not where one lies in the other."""
    one = make_track(ids=range(9), track_id=0)
    near = make_track((6.0, 0.0, 0.0), ids=(90, 91), track_id=1)
    assert ids_after((one, near)) == [0]
    seen_ns = FRAME_NS + BESIDE_NS
    assert ids_after((one._replace(updated_ns=seen_ns), near._replace(updated_ns=seen_ns))) == [
        0,
        1,
    ]
    within = make_track((1.0, 0.0, 0.0), ids=(90, 91), track_id=1)
    both = (one._replace(updated_ns=seen_ns), within._replace(updated_ns=seen_ns))
    assert ids_after(both) == [0]


def test_a_track_that_is_hardly_known_may_be_off() -> None:
    car = make_track(track_id=0)
    new = make_track((7.5, 0.0, 0.0), ids=(7, 8, 9), track_id=1)
    assert ids_after((car, new)) == [0, 1]
    x, f, P = car.body.state
    P = P + np.diag([1.0, 1.0, *np.zeros(len(P) - 2)])
    assert ids_after((car._replace(body=car.body._replace(state=BodyState(x, f, P))), new)) == [0]
