"""The classes of tracks, and which of them are whole in view."""

import numpy as np
from object_fixtures import T_WORLD_CAM0, make_track, small_rig

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.motion_class import CLASSES
from ovmot.objects.track import Track
from ovmot.objects.track_class import with_classes

CAR = np.array([4.4, 1.8, 1.45])
CYCLIST = np.array([1.7, 0.55, 1.7])


def classified_after(
    seconds: float,
    speed: float,
    size: FloatArray,
    at: tuple[float, float, float] = (12.0, 0.0, 1.0),
) -> Track:
    """A track whose two sides are in view, after some seconds."""
    track = make_track(at, (speed, 0.0, 0.0), size=size)
    shown = track.box.shown._replace(faces=np.ones(3, np.bool_))
    track = track._replace(box=track.box._replace(shown=shown))
    for _ in range(int(10.0 * seconds)):
        (track,) = with_classes([track], T_WORLD_CAM0, small_rig())
    return track


def test_a_cyclist_has_a_cyclists_size_and_a_car_a_cars() -> None:
    assert CLASSES[classified_after(1.0, 4.5, CYCLIST).kind] == "cyclist"
    assert CLASSES[classified_after(1.0, 4.5, CAR).kind] == "vehicle"
    assert CLASSES[classified_after(1.0, 1.3, np.array([0.4, 0.5, 1.7])).kind] == "walker"


def test_a_new_body_has_a_cars_size_until_it_is_classified() -> None:
    assert CLASSES[make_track((12.0, 0.0, 1.0), (4.5, 0.0, 0.0), size=CYCLIST).kind] == "vehicle"


def test_a_body_at_the_border_is_not_whole_in_view() -> None:
    assert classified_after(0.1, 4.5, CAR).whole
    assert not classified_after(0.1, 4.5, CAR, (12.0, 9.0, 1.0)).whole
    assert with_classes([], T_WORLD_CAM0, small_rig()) == ()


def test_a_body_behind_another_is_not_whole_in_view() -> None:
    near, far = make_track((10.0, 0.0, 1.0)), make_track((20.0, 0.5, 1.0))
    aside = make_track((20.0, 6.0, 1.0))
    found = with_classes([far, near, aside], T_WORLD_CAM0, small_rig())
    assert [track.whole for track in found] == [False, True, True]


def test_what_drives_is_a_vehicle_until_a_side_of_it_was_in_view() -> None:
    track = make_track((12.0, 0.0, 1.0), (4.5, 0.0, 0.0), size=CYCLIST)
    likely = track._replace(class_probability=np.array([0.1, 0.8, 0.1]))
    assert likely.heading.drives and CLASSES[likely.kind] == "vehicle"
    faces = np.array([False, True, True])
    shown = likely.box._replace(shown=likely.box.shown._replace(faces=faces))
    assert CLASSES[likely._replace(box=shown).kind] == "cyclist"


def test_two_who_walk_side_by_side_are_no_vehicle() -> None:
    pair = classified_after(1.0, 1.3, np.array([0.5, 1.1, 1.7]))
    assert CLASSES[int(np.argmax(pair.class_probability))] == "vehicle"
    assert CLASSES[pair.kind] == "walker"
