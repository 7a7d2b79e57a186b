"""Which sides of a true object the rig could see, and whether it was whole in view."""

from dataclasses import replace

import numpy as np
import pytest
from true_objects import objects_at, tracks_at

from ovmot.cameras.camera import Camera
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, compare_frame
from ovmot.evaluation.object_views import two_sides_seen, visible_sides, whole_in_view
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray

CAMERA = Camera.make((640, 280), (400.0, 400.0), (319.5, 139.5))
T_CAM0_IMU = se3.make(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.8, 0.0])
)


def frame_at(
    x: float, y: float, *, yaw: float = 0.0, pixels: int = 900, stamp: int = 0
) -> ComparedFrame:
    """A car 4 x 2 x 1.6 m at (x, y), seen from the origin along x."""
    objects = objects_at(x, yaw=yaw, pixels=pixels, stamp=stamp)
    objects = replace(objects, center=np.array([[x, y, 0.8]]))
    return compare_frame(objects, tracks_at(stamp=stamp), np.eye(4), np.eye(4), ObjectCriteria())


@pytest.mark.parametrize(
    ("x", "y", "yaw", "end", "flank"),
    [
        (20.0, 0.0, 0.0, True, False),  # right ahead: its rear alone
        (20.0, 0.0, 0.5 * np.pi, False, True),  # across: its flank alone
        (20.0, 0.0, 0.25 * np.pi, True, True),
        (12.0, 4.0, 0.0, True, True),
        (0.0, 4.0, 0.0, False, True),  # abreast of the rig
        (40.0, 1.2, 0.0, True, False),  # the flank is foreshortened
        (0.5, 0.3, 0.0, False, False),  # around the rig
    ],
)
def test_sides_by_the_direction_from_which_they_are_seen(
    x: float, y: float, yaw: float, end: bool, flank: bool
) -> None:
    found = visible_sides(frame_at(x, y, yaw=yaw).objects, np.zeros(2))
    assert (bool(found[0][0]), bool(found[1][0])) == (end, flank)


def test_two_sides_add_up_over_the_frames() -> None:
    frames = [frame_at(20.0, 0.0), frame_at(20.0, 0.0, yaw=0.5 * np.pi), frame_at(40.0, 0.0)]
    yes, no = np.array([True]), np.array([False])
    assert [bool(s[0]) for s in two_sides_seen(frames, [yes, yes, yes])] == [False, True, True]
    assert [bool(s[0]) for s in two_sides_seen(frames, [yes, no, yes])] == [False, False, False]


def whole_pixels(x: float, y: float) -> int:
    """Half of the outline of the car's box: what a car shows of it, less its corners."""
    area: FloatArray = np.array([400.0**2 * 2.0 * 1.6 / (x - 2.0) ** 2])
    return int(0.5 * area[0]) if y == 0.0 else 900


def test_a_body_is_whole_if_nothing_hides_it_and_no_edge_cuts_it() -> None:
    full = [frame_at(x, 0.0, pixels=whole_pixels(x, 0.0), stamp=i) for i, x in enumerate((20, 15))]
    hidden = frame_at(15.0, 0.0, pixels=int(0.6 * whole_pixels(15.0, 0.0)), stamp=2)
    cut = frame_at(6.0, 4.2, pixels=20_000, stamp=3)  # its near corner is left of the image
    behind = frame_at(-20.0, 0.0, pixels=0, stamp=4)
    found = whole_in_view([*full, hidden, cut, behind], CAMERA, T_CAM0_IMU)
    assert [bool(whole[0]) for whole in found] == [True, True, False, False, False]
