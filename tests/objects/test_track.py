"""One track: how it starts, is predicted and updated, and what happens when it is lost."""

from dataclasses import replace

import numpy as np
import pytest
from object_fixtures import FRAME_NS, frame_of, make_body, make_track, measurement, scene_points

from ovmot.geometry.arrays import IntArray
from ovmot.objects.body import advance
from ovmot.objects.body_step_kernel import FrameViews
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.track import (
    TrackState,
    advance_track,
    found_again,
    horizontal_variance,
    lens_doubt,
    measured_track,
    moves_for_sure,
    start_track,
)
from ovmot.settings import ObjectTrackSettings


def crossing(n: int, velocity: list[float], sigma: list[float]) -> ObjectMeasurement:
    P = np.diag(np.concatenate([[0.1, 0.1, 0.1], sigma]) ** 2)
    return replace(measurement(velocity=velocity, ids=range(n)), covariance=P, scaled_covariance=P)


@pytest.mark.parametrize(
    ("n", "velocity", "state"),
    [
        (5, [1.0, 5.0, 0.0], TrackState.CONFIRMED),
        (4, [1.0, 5.0, 0.0], TrackState.TENTATIVE),  # few
        (9, [1.0, 0.9, 0.0], TrackState.TENTATIVE),  # not sure
        (9, [12.0, 5.0, 0.0], TrackState.TENTATIVE),  # along the ray: patches that slide
    ],
)
def test_one_measurement_of_many_features_that_surely_cross_is_enough(
    n: int, velocity: list[float], state: TrackState
) -> None:
    seen = crossing(n, velocity, [1.0, 0.2, 0.2])
    body = make_body(velocity=velocity, ids=range(n))
    assert start_track(0, frame_of(scene_points([])), seen, body).state == state


def test_unseen_a_track_coasts_and_becomes_unsure() -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0))
    later = advance_track(track, frame_of(scene_points([]), 6 * FRAME_NS))
    assert later.state == TrackState.COASTING
    np.testing.assert_allclose(later.position - track.position, [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(later.box.hull_centre - track.box.hull_centre, [2.0, 0.0, 0.0])
    assert horizontal_variance(later) > horizontal_variance(track)
    tentative = track._replace(state=TrackState.TENTATIVE)
    assert advance_track(tentative, frame_of(scene_points([]))).state == TrackState.TENTATIVE


def test_seen_by_joined_features_alone_a_track_keeps_its_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0), ids=(1, 2))
    frame = frame_of(scene_points([]), 2 * FRAME_NS)
    body = advance(track.body, frame)
    no_outline = body.map._replace(outline=np.zeros_like(body.map.outline))
    seen = body._replace(map=no_outline, n_used=2)
    monkeypatch.setattr("ovmot.objects.track.advance", lambda *_: seen)
    later = advance_track(track, frame)
    assert later.state == TrackState.CONFIRMED
    assert later.updated_ns == frame.timestamp_ns
    np.testing.assert_allclose(later.size, track.size)
    np.testing.assert_allclose(later.position - track.position, [0.4, 0.0, 0.0], atol=1e-9)


def test_measurements_confirm_a_track() -> None:
    settings, seen = ObjectTrackSettings(), measurement(ids=range(3))
    track = make_track(state=TrackState.TENTATIVE, hits=1)
    own = np.empty(0, dtype=np.int64)
    states = []
    for k in range(2, 5):
        track = measured_track(track, seen, own, frame_of(scene_points([]), k * FRAME_NS), settings)
        states.append(track.state)
    assert states == [TrackState.TENTATIVE, TrackState.CONFIRMED, TrackState.CONFIRMED]
    assert (track.hits, track.updated_ns) == (4, 4 * FRAME_NS)


def test_found_again_a_track_has_its_size_and_another_body() -> None:
    track = make_track((10.0, 1.0, 1.0), (4.0, 0.0, 0.0))
    part = make_body((14.0, 1.0, 1.0), (4.0, 0.0, 0.0), ids=(5,), size=np.array([1.0, 0.5, 0.5]))
    found = found_again(track, part, frame_of(scene_points([])))
    assert found.track_id == track.track_id
    np.testing.assert_allclose(found.size, track.size, atol=1e-3)
    assert found.feature_id.tolist() == [5]


@pytest.mark.parametrize(
    ("velocity", "age_s", "sure"),
    [
        ((3.4, 0.0, 0.0), 0.0, False),  # 1 m at 14 m: half a pixel of disparity
        ((0.0, 3.4, 0.0), 0.0, True),
        ((9.0, 0.0, 0.0), 0.0, True),
        ((3.4, 0.0, 0.0), 1.0, True),  # since its birth it has come farther
    ],
)
def test_a_motion_along_the_ray_must_be_more_than_lenses_err(
    velocity: tuple[float, float, float], age_s: float, sure: bool
) -> None:
    seen = measurement((14.0, 0.0, 1.6), velocity, range(9), span_s=0.3)
    frame = frame_of(scene_points([]))
    born_ns = frame.timestamp_ns - round(1e9 * age_s)
    assert moves_for_sure(seen, born_ns, frame) is sure
    track = make_track((14.0, 0.0, 1.6), velocity, state=TrackState.TENTATIVE, hits=1)
    track = track._replace(born_ns=born_ns)
    own = np.arange(9)
    after = measured_track(track, seen, own, frame_with(own), ObjectTrackSettings())
    assert after.state == (TrackState.CONFIRMED if sure else TrackState.TENTATIVE)


def test_a_turning_rig_leaves_more_in_doubt_across_the_ray() -> None:
    """In a corner of the picture a lens may be off by a tenth of the way that it sees pass."""
    frame, position = frame_of(scene_points([])), np.array([14.0, 0.0, 1.6])
    turning = frame._replace(turn_rate_rps=0.5)
    standing, doubt = (lens_doubt(position, 0.3, f) for f in (frame, turning))
    np.testing.assert_allclose(np.diag(standing)[1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diag(doubt)[1:], (0.1 * 0.5 * 14.0) ** 2)
    assert doubt[0, 0] == pytest.approx(standing[0, 0])
    seen = crossing(9, [0.0, 2.0, 0.0], [1.0, 0.1, 0.1])
    seen = replace(seen, position=position)
    body = make_body((14.0, 0.0, 1.6), (0.0, 2.0, 0.0), ids=range(9))
    assert start_track(0, frame, seen, body).state == TrackState.CONFIRMED
    assert start_track(0, turning, seen, body).state == TrackState.TENTATIVE


def frame_with(ids: IntArray) -> FrameViews:
    """A frame that sees these features 14 m ahead."""
    p_cam0 = np.tile([0.0, 0.0, 14.0], (len(ids), 1))
    return frame_of(scene_points([2] * len(ids), feature_id=ids, p_cam0=p_cam0))
