"""Tracking in one camera: where new features are wanted, around what may move and elsewhere."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from painted_bodies import street_and_body

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.klt_tracker import FeatureIds, KltTracker, static_world
from ovmot.frontend.preprocessing import preprocess
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry.arrays import Image
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import StereoFrame

SETTINGS = TrackerSettings(
    max_features=40, fast_threshold=12, equalization="none", focus_features=60, fine_columns=13,
)  # fmt: skip


def textured(seed: int = 0) -> Image:
    """Small dark squares on grey, apart from each other: corners everywhere."""
    rng = np.random.default_rng(seed)
    image = rng.integers(115, 125, (240, 320)).astype(np.uint8)
    for v in range(4, 232, 12):
        for u in range(4, 312, 12):
            i, j = rng.integers(0, 5, 2)
            image[v + i : v + i + 4, u + j : u + j + 4] = rng.integers(20, 60, (4, 4))
    return image


def test_more_features_where_something_may_move(painted_rig: StereoRig) -> None:
    image = textured()
    tracker = StereoTracker(painted_rig, SETTINGS, EpipolarSettings())
    try:
        first, _ = tracker.track(StereoFrame(0, image, image), np.eye(4), no_feedback(painted_rig))
        feedback = replace(
            no_feedback(painted_rig),
            focus_uv=np.array([[150.0, 120.0]]),
            focus_radius_px=np.array([30.0]),
        )
        second, _ = tracker.track(StereoFrame(1, image, image), np.eye(4), feedback)
    finally:
        tracker.close()

    def around(pixels: np.ndarray) -> int:
        return int((np.linalg.norm(pixels[:, :2] - [150.0, 120.0], axis=1) < 30.0).sum())

    assert around(second.pixels) > 3 * max(around(first.pixels), 2)
    assert around(second.pixels) <= 60
    kept = np.isin(first.feature_id, second.feature_id).mean()
    assert kept > 0.9


def test_a_covered_part_of_the_image_gets_features_though_there_are_enough(
    painted_rig: StereoRig,
) -> None:
    covered = textured()
    image = covered.copy()
    image[60:180, 100:220] = 120  # a wall without texture, until something comes before it
    tracker = StereoTracker(painted_rig, SETTINGS, EpipolarSettings())
    try:
        before, _ = tracker.track(StereoFrame(0, image, image), np.eye(4), no_feedback(painted_rig))
        after, _ = tracker.track(
            StereoFrame(1, covered, covered), np.eye(4), no_feedback(painted_rig)
        )
    finally:
        tracker.close()
    assert len(before) >= 40
    u, v = after.pixels[:, 0], after.pixels[:, 1]
    inside = (u > 105) & (u < 215) & (v > 65) & (v < 175)
    fresh = inside & ~np.isin(after.feature_id, before.feature_id)
    assert fresh.sum() >= 4


@pytest.fixture
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


def test_a_body_that_has_just_come_into_view_is_searched_where_flow_does_not_reach(
    painted_rig: StereoRig, workers: ThreadPoolExecutor
) -> None:
    """It moves by 34 pixels at 10 m, 1.7 m, as one of 2 m does; what is static stays."""
    settings = TrackerSettings(fine_columns=16, equalization="none")
    tracker = KltTracker(settings, workers, FeatureIds())
    images = street_and_body(100), street_and_body(134)
    views = [
        preprocess(StereoFrame(k, image, image), painted_rig, settings, workers)[0]
        for k, image in enumerate(images)
    ]
    nowhere, none = np.empty((0, 3)), np.empty(0, dtype=np.int64)
    first = tracker.step(views[0], static_world(nowhere, np.eye(4)), None, none)
    p = 10.0 * np.column_stack([first.xy, np.ones(len(first))])
    expected = static_world(p, np.eye(4))._replace(way_m=2.0)
    second = tracker.step(views[1], expected, None, none)
    _, a, b = np.intersect1d(first.feature_id, second.feature_id, return_indices=True)
    moved = second.uv[b] - first.uv[a]
    on_body = ((first.uv[a] > [108, 98]) & (first.uv[a] < [152, 142])).all(axis=1)
    assert on_body.sum() >= 4
    assert (np.abs(moved[on_body] - [34.0, 0.0]).max(axis=1) < 0.3).mean() > 0.7
    away = (first.uv[a, 1] < 80) | (first.uv[a, 1] > 160)
    assert np.quantile(np.abs(moved[away]).max(axis=1), 0.95) < 0.1
    np.testing.assert_allclose(second.depth[b][away], 10.0)


def test_the_nearer_a_body_is_the_farther_it_is_searched(
    painted_rig: StereoRig, workers: ThreadPoolExecutor
) -> None:
    """1.5 m are 30 pixels at 10 m and 60 at 5 m: of two bodies that move by 45 pixels, the near one
    is found."""
    settings = TrackerSettings(fine_columns=16, equalization="none")
    images = street_and_body(100), street_and_body(145)
    views = [
        preprocess(StereoFrame(k, image, image), painted_rig, settings, workers)[0]
        for k, image in enumerate(images)
    ]
    nowhere, none = np.empty((0, 3)), np.empty(0, dtype=np.int64)
    share = {}
    for depth in (10.0, 5.0):
        tracker = KltTracker(settings, workers, FeatureIds())
        first = tracker.step(views[0], static_world(nowhere, np.eye(4)), None, none)
        p = depth * np.column_stack([first.xy, np.ones(len(first))])
        expected = static_world(p, np.eye(4))._replace(way_m=1.5)
        second = tracker.step(views[1], expected, None, none)
        body = first.feature_id[((first.uv > [108, 98]) & (first.uv < [152, 142])).all(axis=1)]
        ids, a, b = np.intersect1d(first.feature_id, second.feature_id, return_indices=True)
        off = np.abs(second.uv[b] - first.uv[a] - [45.0, 0.0]).max(axis=1)
        share[depth] = np.isin(body, ids[off < 0.3]).mean()
    assert share[5.0] > 0.6
    assert share[10.0] < 0.1


def test_ids_are_given_once() -> None:
    ids = FeatureIds()
    assert ids.take(3).tolist() == [0, 1, 2]
    assert ids.take(0).tolist() == []
    assert ids.take(2).tolist() == [3, 4]
