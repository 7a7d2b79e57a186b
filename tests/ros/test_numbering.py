"""Numbers of pipelines that follow each other."""

from dataclasses import replace

import numpy as np

from ovmot.ros.numbering import Numbers
from ovmot.types import FrameResult


def test_every_number_of_a_result_is_moved_and_none_stays_none(result: FrameResult) -> None:
    moved = Numbers(segment=2, track=50, feature=1000).applied(replace(result, segment=1))
    assert moved.segment == 3
    assert [t.track_id for t in moved.tracks] == [57, 58, 59]
    assert moved.points.track_id.tolist() == [-1, 57, -1, -1]
    np.testing.assert_array_equal(moved.points.feature_id, result.points.feature_id + 1000)
    np.testing.assert_array_equal(moved.matches.feature_id, result.matches.feature_id + 1000)
    assert [t.track_id for t in result.tracks] == [7, 8, 9]


def test_what_is_free_lies_beyond_all_that_was_used(result: FrameResult) -> None:
    free = Numbers().beyond(result)
    assert free == Numbers(segment=1, track=10, feature=104)
    assert free.beyond(result) == free
    empty = replace(result, tracks=())
    assert Numbers(segment=5, track=60, feature=9).beyond(empty) == Numbers(5, 60, 104)


def test_matches_without_a_point_count_too(result: FrameResult) -> None:
    matches = replace(result.matches, feature_id=np.array([300]))
    assert Numbers().beyond(replace(result, matches=matches)).feature == 301
