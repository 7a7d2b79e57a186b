"""The filter leaves the points of moving bodies alone, but keeps most of the picture."""

from dataclasses import replace

import numpy as np

from ovmot.objects.exclusion import excluded_features
from ovmot.types import PointLabel, ScenePoints


def _seen(owner: list[int], label: list[PointLabel]) -> ScenePoints:
    n = len(owner)
    two, one = np.full((n, 2), np.nan), np.full(n, np.nan)
    return ScenePoints(
        feature_id=np.arange(n) + 10, pixels=np.full((n, 4), np.nan),
        p_cam0=np.full((n, 3), np.nan), cov_cam0=np.full((n, 3, 3), np.nan),
        label=np.array([int(k) for k in label]), track_id=np.array(owner),
        previous=two, predicted=two, distance_m=one, reprojection_px=one,
        two_view_inlier=np.ones(n, dtype=np.bool_),
    )  # fmt: skip


def test_points_of_moving_bodies_are_left_out() -> None:
    moves, may, rests = PointLabel.DYNAMIC, PointLabel.UNKNOWN, PointLabel.STATIC
    seen = _seen([-1, -1, -1, 3, 3, 7], [rests, may, moves, moves, may, rests])
    # not the loose ones, which the split bars, and not those of a body that stands
    np.testing.assert_array_equal(excluded_features(seen, 0.5), [13, 14])
    none = replace(seen, track_id=np.full(6, -1))
    assert len(excluded_features(none, 0.5)) == 0


def test_a_body_with_most_of_the_picture_starves_nobody() -> None:
    moves = PointLabel.DYNAMIC
    seen = _seen([1] * 6 + [2, 2] + [-1] * 2, [moves] * 8 + [PointLabel.STATIC] * 2)
    np.testing.assert_array_equal(excluded_features(seen, 0.5), [16, 17])
    np.testing.assert_array_equal(excluded_features(seen, 0.8), np.arange(10, 18))
