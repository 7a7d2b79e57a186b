"""Tracking in one camera: where new features are wanted, around what may move and elsewhere."""

from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry.arrays import Image
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import StereoFrame

SETTINGS = TrackerSettings(
    max_features=40, min_distance_px=14.0, fast_threshold=12, equalization="none",
    focus_features=60, focus_distance_px=5.0, fine_columns=8,
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
