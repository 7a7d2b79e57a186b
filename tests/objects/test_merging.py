"""Duplicates of a body are merged; bodies side by side are not."""

from dataclasses import replace

import numpy as np
from object_fixtures import FRAME_NS, make_track

from ovmot.objects.merging import BESIDE_NS, merge_duplicates
from ovmot.objects.track import Track, TrackState
from ovmot.settings import ObjectTrackSettings

SETTINGS = ObjectTrackSettings(merge_frames=3)


def ids_after(tracks: tuple[Track, ...], frames: int = 5) -> list[int]:
    for _ in range(frames):
        tracks = merge_duplicates(tracks, SETTINGS)
    return [track.track_id for track in tracks]


def test_a_duplicate_is_merged_after_some_frames() -> None:
    old = make_track(ids=(1, 2, 3), track_id=0)
    new = make_track((0.8, 0.0, 0.0), ids=(7, 8, 9, 10), track_id=1)
    assert ids_after((old, new), 2) == [0, 1]
    assert ids_after((old, new), 3) == [0]
    (merged,) = merge_duplicates((old, replace(new, overlaps=2)), SETTINGS)
    assert merged.feature_id.tolist() == [1, 2, 3, 7, 8, 9, 10]
    np.testing.assert_array_equal(merged.position, new.position)  # it has more features


def test_a_young_duplicate_is_not_confirmed() -> None:
    old = make_track(ids=range(10), track_id=0)
    young = make_track((0.5, 0.0, 0.0), ids=(20,), track_id=1, hits=2)
    _, kept = merge_duplicates((old, young), SETTINGS)
    assert (kept.state, kept.overlaps) == (TrackState.TENTATIVE, 1)


def test_the_count_of_overlaps_goes_down_apart() -> None:
    old = make_track(track_id=0)
    far = replace(make_track((0.0, 9.0, 0.0), track_id=1), overlaps=2)
    assert merge_duplicates((old, far), SETTINGS)[1].overlaps == 1


def test_bodies_side_by_side_or_at_other_speeds_stay_two() -> None:
    one = make_track(ids=(1, 2, 3), track_id=0)
    assert ids_after((one, make_track((0.0, 3.4, 0.0), ids=(7, 8, 9), track_id=1))) == [0, 1]
    faster = make_track((2.5, 0.0, 0.0), (6.0, 0.0, 0.0), ids=(7, 8, 9), track_id=1)
    assert ids_after((one, faster)) == [0, 1]


def test_few_features_at_the_far_end_of_a_lorry_are_of_it() -> None:
    size = np.array([9.0, 2.5, 3.0])
    lorry = make_track(velocity=(8.0, 0.0, 0.0), ids=range(40), track_id=0, size=size)
    end = make_track((6.5, 0.0, 0.0), (8.0, 0.0, 0.0), ids=(90, 91), track_id=1)
    assert ids_after((lorry, end)) == [0]
    apart = make_track((11.0, 0.0, 0.0), (8.0, 0.0, 0.0), ids=(90, 91), track_id=1)
    assert ids_after((lorry, apart)) == [0, 1]


def test_a_coasting_track_may_be_off_unless_both_were_seen_together() -> None:
    unsure = make_track((0.0, 0.0, 0.0), track_id=0, state=TrackState.COASTING)
    models = {
        name: replace(e, covariance=e.covariance + np.diag([1.0, 1.0, 0, 0, 0, 0, 0]))
        for name, e in unsure.filter.models.items()
    }
    unsure = replace(unsure, filter=replace(unsure.filter, models=models))
    new = make_track((0.0, 3.4, 0.0), ids=(7, 8, 9), track_id=1)
    assert ids_after((unsure, new)) == [0]
    beside = replace(unsure, updated_ns=FRAME_NS + BESIDE_NS)
    assert ids_after((beside, new)) == [0, 1]
