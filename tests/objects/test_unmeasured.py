"""Tracks without a measurement: by their own features, found again, or coasting."""

import numpy as np
import pytest
from object_fixtures import FRAME_NS, feature_motions, make_track

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.track import Track, TrackState, predict_track
from ovmot.objects.unmeasured import consistent_body, recovery_candidates, update_unmeasured

V = np.array([3.0, 0.0, 0.0])
NOW_NS = 2 * FRAME_NS


def after_a_frame(
    velocity: FloatArray, ids: tuple[int, ...], state: TrackState = TrackState.CONFIRMED
) -> Track:
    """A track at V after one frame with features at these velocities, all in its box."""
    track = make_track(velocity=(3.0, 0.0, 0.0), ids=ids, state=state)
    track = predict_track(track, NOW_NS)
    n = len(velocity)
    p_world = track.position + np.random.default_rng(1).uniform(-0.5, 0.5, (n, 3))
    motions = feature_motions(velocity, p_world, sigma=0.1)
    everywhere = np.ones(n, dtype=np.bool_)
    return update_unmeasured(track, motions, everywhere, everywhere, NOW_NS)


def test_own_features_update_a_track() -> None:
    track = after_a_frame(np.tile([2.6, 0.0, 0.0], (5, 1)), (0, 1, 2, 3, 4))
    assert track.state == TrackState.CONFIRMED
    assert track.updated_ns == NOW_NS and track.measured_ns == FRAME_NS
    assert 2.6 < track.velocity[0] < 2.95


def test_a_feature_with_another_velocity_leaves() -> None:
    v = np.vstack([np.tile(V, (4, 1)), [[0.0, 3.0, 0.0]]])
    track = after_a_frame(v, (0, 1, 2, 3, 4))
    assert track.feature_id.tolist() == [0, 1, 2, 3]


def test_other_features_with_its_velocity_find_a_coasting_track() -> None:
    v = np.vstack([np.tile(V, (2, 1)), np.zeros((3, 3))])
    assert after_a_frame(v, (50, 51), TrackState.COASTING).state == TrackState.CONFIRMED
    assert after_a_frame(v[1:], (50, 51), TrackState.COASTING).state == TrackState.COASTING


@pytest.mark.parametrize("state", [TrackState.CONFIRMED, TrackState.COASTING])
def test_static_features_do_not_stop_a_track(state: TrackState) -> None:
    track = after_a_frame(np.zeros((6, 3)), (0, 1, 2, 3, 4, 5), state)
    assert track.state == TrackState.COASTING
    np.testing.assert_allclose(track.velocity, V, atol=1e-3)


def test_a_tentative_track_begins_again() -> None:
    track = after_a_frame(np.tile(V, (5, 1)), (0, 1, 2, 3, 4), TrackState.TENTATIVE)
    assert (track.state, track.hits, track.evidence) == (TrackState.TENTATIVE, 0, 0.0)


def test_the_largest_consensus_speaks() -> None:
    v = np.vstack([np.tile([1.0, 0.0, 0.0], (3, 1)), np.tile([0.0, 2.0, 0.0], (4, 1))])
    own = np.ones(7, dtype=np.bool_)
    body = consistent_body(feature_motions(v, sigma=0.1), own, np.array([1.0, 0.0, 0.0]))
    assert body is not None
    np.testing.assert_allclose(body.velocity, [0.0, 2.0, 0.0], atol=1e-9)
    assert body.outlier_id.tolist() == [0, 1, 2]
    assert np.linalg.eigvalsh(body.covariance).min() > 0.0
    own[2:] = False
    assert consistent_body(feature_motions(v), own, V) is None


def test_no_track_is_found_again_where_another_body_is() -> None:
    """Three features: in both boxes, in the first's, and in the first's but held by another."""
    first = make_track(track_id=1, now_ns=FRAME_NS)
    beside = make_track(track_id=2, now_ns=FRAME_NS)
    in_box = np.array([[True, True, True], [True, False, False]])
    held = np.array([-1, -1, 9])
    alone = recovery_candidates([first, beside], in_box, held)
    np.testing.assert_array_equal(alone, [[True, True, False], [True, False, False]])
    # once they were seen side by side for long
    old = make_track(track_id=2, now_ns=-10 * FRAME_NS)
    together = recovery_candidates([first, old], in_box, held)
    np.testing.assert_array_equal(together[0], [False, True, False])
