"""The objects' stage: what the odometry source must not use, and what it keeps of the image."""

from dataclasses import replace

import numpy as np
from object_fixtures import scene_points

from ovmot.objects.moving_objects import held_features
from ovmot.types import PointLabel


def test_points_of_moving_bodies_are_held() -> None:
    moves, may, rests = PointLabel.DYNAMIC, PointLabel.UNKNOWN, PointLabel.STATIC
    seen = scene_points(
        [rests, may, moves, moves, may, rests], [-1, -1, -1, 3, 3, 7], np.arange(10, 16)
    )
    # not those of no track, which the segmentation marks, and not those of a track at rest
    np.testing.assert_array_equal(held_features(seen, 0.5), [13, 14])
    none = replace(seen, track_id=np.full(6, -1))
    assert len(held_features(none, 0.5)) == 0


def test_a_body_with_most_of_the_image_holds_nothing() -> None:
    moves = PointLabel.DYNAMIC
    seen = scene_points(
        [moves] * 8 + [PointLabel.STATIC] * 2, [1] * 6 + [2, 2] + [-1] * 2, np.arange(10, 20)
    )
    np.testing.assert_array_equal(held_features(seen, 0.5), [16, 17])
    np.testing.assert_array_equal(held_features(seen, 0.8), np.arange(10, 18))
