"""One track: how it starts, is predicted and updated, and what happens when it is lost."""

import math

import numpy as np
import pytest
from object_fixtures import FRAME_NS, T_WORLD_CAM0, frame_of, make_body, make_track, scene_points

from ovmot.objects.body import advance
from ovmot.objects.motion_evidence import Origin
from ovmot.objects.track import (
    Track,
    TrackState,
    advance_track,
    found_again,
    horizontal_variance,
    measured_track,
    rests,
    start_track,
    with_box,
)
from ovmot.settings import ObjectTrackSettings

SETTINGS = ObjectTrackSettings()


def started(way: tuple[float, float, float], n: int) -> Track:
    """A track of a body of n features that has come this way in 0.3 s, 14 m before a rig that
    drives past."""
    frame, place = frame_of(scene_points([])), np.array([14.0, 0.0, 1.6])
    before = T_WORLD_CAM0.copy()
    before[1, 3] = 0.5
    origin = Origin(frame.timestamp_ns - 300_000_000, place - np.array(way), before)
    body = make_body(tuple(place), tuple(np.array(way) / 0.3), ids=range(n))._replace(n_used=n)
    return start_track(0, frame, body, origin, n, SETTINGS)


@pytest.mark.parametrize(
    ("n", "way", "state"),
    [
        (4, (0.3, 1.5, 0.0), TrackState.CONFIRMED),
        (3, (0.3, 1.5, 0.0), TrackState.TENTATIVE),  # few
        (9, (0.1, 0.2, 0.0), TrackState.TENTATIVE),  # not sure
        (9, (1.0, 0.1, 0.0), TrackState.TENTATIVE),  # along the ray: what lenses err by
    ],
)
def test_one_measurement_of_many_features_that_surely_move_is_enough(
    n: int, way: tuple[float, float, float], state: TrackState
) -> None:
    assert started(way, n).state == state


def test_unseen_a_track_coasts_and_becomes_unsure() -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0))
    later = advance_track(track, frame_of(scene_points([]), 6 * FRAME_NS), SETTINGS)
    assert later.state == TrackState.COASTING
    np.testing.assert_allclose(later.position - track.position, [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(later.box.hull_centre - track.box.hull_centre, [2.0, 0.0, 0.0])
    assert horizontal_variance(later) > horizontal_variance(track)
    tentative = track._replace(state=TrackState.TENTATIVE)
    assert (
        advance_track(tentative, frame_of(scene_points([])), SETTINGS).state == TrackState.TENTATIVE
    )


def test_seen_by_joined_features_alone_a_track_keeps_its_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0), ids=(1, 2))
    frame = frame_of(scene_points([]), 2 * FRAME_NS)
    body = advance(track.body, frame)
    no_outline = body.map._replace(outline=np.zeros_like(body.map.outline))
    seen = body._replace(map=no_outline, n_used=2)
    monkeypatch.setattr("ovmot.objects.track.advance", lambda *_: seen)
    later = advance_track(track, frame, SETTINGS)
    assert later.state == TrackState.CONFIRMED
    assert later.updated_ns == frame.timestamp_ns
    np.testing.assert_allclose(later.size, track.size)
    np.testing.assert_allclose(later.position - track.position, [0.4, 0.0, 0.0], atol=1e-9)


def test_measurements_confirm_a_track_of_few_features() -> None:
    """A car that crosses near, of three: in its third frame. Then it is not tested again."""
    none, track = np.empty(0, dtype=np.int64), started((0.3, 1.5, 0.0), 3)
    states, ratios = [track.state], [track.log_ratio]
    frame = frame_of(scene_points([]), 2 * FRAME_NS)
    for _ in range(3):
        track = measured_track(track, none, frame, SETTINGS)
        states.append(track.state)
        ratios.append(track.log_ratio)
    assert states == [TrackState.TENTATIVE] * 2 + [TrackState.CONFIRMED] * 2
    assert ratios[0] < ratios[1] < ratios[2] == ratios[3]
    assert (track.remeasured, track.updated_ns) == (3, 2 * FRAME_NS)


def test_a_body_of_another_tracks_features_is_not_confirmed_at_once() -> None:
    track = started((0.3, 1.5, 0.0), 9)
    again = start_track(1, frame_of(scene_points([])), track.body, track.origin, 2, SETTINGS)
    assert (track.state, again.state) == (TrackState.CONFIRMED, TrackState.TENTATIVE)


def test_a_track_without_an_outline_keeps_its_box() -> None:
    track = make_track((10.0, 1.0, 1.0), ids=[4, 5])
    m = track.body.map
    bare = track._replace(body=track.body._replace(map=m._replace(outline=m.outline & False)))
    assert with_box(bare, frame_of(scene_points([]))).box is track.box


def test_what_rests_is_dropped() -> None:
    """A tentative track ends as soon as rest is likelier by the bound; a confirmed one does not."""
    track = make_track(state=TrackState.TENTATIVE)
    bound = math.log(SETTINGS.miss / (1.0 - SETTINGS.false_alarm))
    assert not rests(track._replace(log_ratio=bound + 0.1), SETTINGS)
    assert rests(track._replace(log_ratio=bound - 0.1), SETTINGS)
    confirmed = track._replace(state=TrackState.CONFIRMED, log_ratio=bound - 0.1)
    assert not rests(confirmed, SETTINGS)


def test_found_again_a_track_is_as_large_as_was_seen_and_has_another_body() -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0))
    part = make_body((14.0, 1.0, 1.0), (4.0, 0.0, 0.0), ids=(5,), size=np.array([1.0, 0.5, 0.5]))
    found = found_again(track, part, track.origin, frame_of(scene_points([])))
    assert found.track_id == track.track_id
    assert np.all(found.size >= track.box.shown.extent - 1e-3)
    assert found.feature_id.tolist() == [5]
