"""Features of a body that was out of sight are found again by their patches."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from painted_bodies import street_and_body

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.hidden_features import (
    REPLY_FRAMES,
    ExpectedPlaces,
    common_displacement,
    expected_places,
    hidden_now,
    none_hidden,
)
from ovmot.frontend.klt_tracker import Expected, FeatureIds, KltTracker, static_world
from ovmot.frontend.preprocessing import View, preprocess
from ovmot.geometry import se3
from ovmot.interfaces import HiddenFeatures
from ovmot.runtime import CallingThread
from ovmot.settings import TrackerSettings
from ovmot.types import StereoFrame

SETTINGS = TrackerSettings(fine_columns=16, equalization="none")
NONE = np.empty(0, np.int64)
DEPTH_M = 10.0


def body_comes_back(rig: StereoRig, n_hidden: int, back_px: int, expected_px: float) -> float:
    """Which share of the features of a body has its old id at the right place, when it comes back
    after some frames, by so many pixels from where it was, while it was expected elsewhere."""
    columns = [100, *[None] * n_hidden, 100 + back_px]
    with ThreadPoolExecutor(2) as workers:

        def view(k: int) -> View:
            image = street_and_body(columns[k])
            return preprocess(StereoFrame(k, image, image), rig, SETTINGS, workers)[0]

        tracker = KltTracker(SETTINGS, CallingThread(), FeatureIds())
        first = tracker.step(view(0), static_world(np.empty((0, 3)), np.eye(4)), None, NONE)
        own = ((first.uv > [108, 98]) & (first.uv < [152, 142])).all(axis=1)
        rows = np.flatnonzero(own)
        p = DEPTH_M * np.column_stack([first.xy[rows], np.ones(len(rows))])
        p[:, 0] += DEPTH_M * expected_px / rig.cam0.fx
        n = len(rows)
        places = ExpectedPlaces(first.feature_id[rows], np.zeros(n, np.int64), p, np.full(n, 0.6))
        now = first
        for k in range(1, len(columns)):
            p_now = np.full((len(now), 3), np.nan)
            expected = Expected(p_now, p_now, np.eye(4), 0.0, places)
            now = tracker.step(view(k), expected, None, NONE)
    _, a, b = np.intersect1d(first.feature_id[rows], now.feature_id, return_indices=True)
    off = np.abs(now.uv[b] - first.uv[rows][a] - [back_px, 0.0]).max(axis=1)
    assert len(np.unique(now.feature_id)) == len(now)
    return np.count_nonzero(off < 0.3) / n


def test_a_body_is_found_again_where_it_stopped(painted_rig: StereoRig) -> None:
    """It was expected 20 pixels farther, in reach of 36; it was hidden for a while, or for long."""
    assert body_comes_back(painted_rig, REPLY_FRAMES - 1, 40, 60.0) > 0.5
    assert body_comes_back(painted_rig, 3 * REPLY_FRAMES, 40, 60.0) > 0.5


def test_a_body_out_of_reach_is_another_one(painted_rig: StereoRig) -> None:
    assert body_comes_back(painted_rig, REPLY_FRAMES, 40, 95.0) == 0.0


def test_what_repeats_itself_is_found_where_all_features_agree() -> None:
    """Each feature fits at three places of a row; the body as a whole at one of them."""
    rng = np.random.default_rng(1)
    expected = rng.uniform(0.0, 60.0, (6, 2))
    shift = np.array([25.0, 3.0])
    corners = np.concatenate([expected + shift, expected[:2] + shift + [40.0, 0.0]])
    alike = np.full((6, 8), 0.2)
    alike[range(6), range(6)] = 0.9
    alike[[0, 1], [6, 7]] = 0.95
    off = corners[None] - expected[:, None]
    feature, corner = common_displacement(alike, off)
    np.testing.assert_array_equal(np.sort(feature), np.arange(6))
    np.testing.assert_array_equal(feature, corner)


def test_two_displacements_that_fit_as_well_are_none() -> None:
    rng = np.random.default_rng(2)
    expected = rng.uniform(0.0, 60.0, (5, 2))
    shift = np.array([20.0, 0.0])
    twice = np.concatenate([expected + shift, expected - shift])
    alike = np.tile(0.9 * np.eye(5), (1, 2))
    feature, _ = common_displacement(alike, twice[None] - expected[:, None])
    assert len(feature) == 0
    few = common_displacement(alike[:2, :2], twice[None, :2] - expected[:2, None])
    assert len(few[0]) == 0


def test_lost_features_are_kept_until_the_objects_have_replied() -> None:
    hidden = hidden_now(none_hidden(), np.arange(3), 10 + np.arange(3), NONE)
    for _ in range(REPLY_FRAMES):
        hidden = hidden_now(hidden, NONE, NONE, NONE)
        assert hidden.feature_id.tolist() == [0, 1, 2]
    hidden = hidden_now(hidden, np.array([7]), np.array([17]), np.array([1]))
    assert hidden.feature_id.tolist() == [1, 7]
    assert hidden.slot.tolist() == [11, 17]


def test_places_are_carried_by_the_motions_since_the_bodies_frame() -> None:
    """The camera of now is two steps on; the features go on with their bodies."""
    steps = [(k, se3.exp(np.array([0.1 * k, 0.0, -0.3, 0.0, 0.02, 0.0]))) for k in (100, 200, 300)]
    p, v = np.array([[1.0, 0.5, 8.0]]), np.array([[2.0, 0.0, -1.0]])
    hidden = HiddenFeatures(100, np.array([4]), np.array([0]), p, np.array([0.7]), v)
    found = expected_places(hidden, 300, steps)
    moved = steps[2][1] @ steps[1][1]
    np.testing.assert_allclose(found.p_now, se3.apply(moved, p + 2e-7 * v), atol=1e-12)
    assert found.feature_id.tolist() == [4]
    assert len(expected_places(hidden._replace(timestamp_ns=50), 300, steps).feature_id) == 0
