"""Who belongs to whom: true objects and tracks of a frame."""

from dataclasses import replace

import numpy as np
import pytest
from true_objects import objects_at, tracks_at

from ovmot.datasets.truth import TrueObjects
from ovmot.evaluation.matching import (
    ObjectCriteria,
    box_distances,
    compare_frame,
    tracking_sequence,
)
from ovmot.evaluation.tracking import clear_mot

STAMP = 100


def test_distance_to_a_turned_box() -> None:
    turned = objects_at(10.0, yaw=0.5 * np.pi)
    points = np.array([[10.0, 3.0, 0.8], [10.0, 6.0, 0.8], [13.0, 3.0, 0.8], [11.5, 5.5, 2.6]])
    expected = [0.0, 1.0, 2.0, np.sqrt(0.25 + 0.25 + 1.0)]
    np.testing.assert_allclose(box_distances(points, turned)[0], expected)


@pytest.mark.parametrize(
    "free", [objects_at(10, speed=0.5), objects_at(10, pixels=300), objects_at(45), objects_at(-9)]
)
def test_what_need_not_be_found_is_neither_hit_nor_miss(free: TrueObjects) -> None:
    x = float(free.center[0, 0])
    frame = compare_frame(free, tracks_at(x), np.eye(4), np.eye(4), ObjectCriteria())
    clear = clear_mot(tracking_sequence([frame], 2.5))
    assert (clear.n_true, clear.n_tracks) == (0, 0)
    away = compare_frame(free, tracks_at(x + 8.0), np.eye(4), np.eye(4), ObjectCriteria())
    assert clear_mot(tracking_sequence([away], 2.5)).false_positives == 1


def test_one_track_too_many_is_false() -> None:
    frame = compare_frame(
        objects_at(10), tracks_at(10.0, 11.0), np.eye(4), np.eye(4), ObjectCriteria()
    )
    clear = clear_mot(tracking_sequence([frame], 2.5))
    assert (clear.hits, clear.false_positives) == (1, 1)


def test_drift_of_the_rig_is_not_counted_twice() -> None:
    T_run = np.eye(4)
    T_run[:3, 3] = [100.0, -50.0, 2.0]
    moved = tracks_at(110.0)
    moved = replace(moved, position=moved.position + np.array([0.0, -50.0, 2.0]))
    frame = compare_frame(objects_at(10), moved, np.eye(4), T_run, ObjectCriteria())
    np.testing.assert_allclose(frame.distance, 0.0, atol=1e-9)
