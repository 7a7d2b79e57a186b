"""Cameras by themselves, on the painted images of two walls."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend import FRONT_ENDS, ImageFrontEnd, klt_tracker
from ovmot.frontend.feature_search import Found, Sought, find_features
from ovmot.frontend.monocular_tracker import MonocularTracker
from ovmot.frontend.preprocessing import View
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame

SETTINGS = TrackerSettings(
    max_features=150, fine_columns=16, fast_threshold=12, equalization="none",
    klt_window_px=13, klt_levels=5,
)  # fmt: skip
STEP_M = 0.15
FOCAL_PX = 200.0
WALLS_M = np.array([5.0, 6.0, 8.0])

Pair = Callable[..., StereoFrame]
Masks = tuple[Image | None, Image | None]


def tracker_of(rig: StereoRig, cameras: str, settings: TrackerSettings = SETTINGS) -> ImageFrontEnd:
    return FRONT_ENDS[cameras](rig, settings, EpipolarSettings(), 1)


def drive(
    tracker: ImageFrontEnd,
    rig: StereoRig,
    painted_pair: Pair,
    n: int = 5,
    masks: Masks = (None, None),
) -> list[FrontendFrame]:
    """The rig goes to its left, and the tracker knows."""
    out = []
    with closing(tracker):
        for i in range(n):
            frame = painted_pair(10**8 * i, STEP_M * i, 0.0, 0)
            frame = replace(frame, left_mask=masks[0], right_mask=masks[1])
            T = se3.make(np.eye(3), np.array([STEP_M if i else 0.0, 0.0, 0.0]))
            seen, matches = tracker.track(frame, T, no_feedback(rig))
            assert isinstance(tracker, StereoTracker) or len(matches.feature_id) == 0
            out.append(seen)
    return out


def in_left(seen: FrontendFrame) -> BoolArray:
    return np.isfinite(seen.pixels[:, 0])


def test_the_left_camera_alone(painted_rig: StereoRig, painted_pair: Pair) -> None:
    seen = drive(tracker_of(painted_rig, "left"), painted_rig, painted_pair)[2]
    assert len(seen) > 80
    assert np.isfinite(seen.pixels[:, :2]).all()
    assert np.isnan(seen.pixels[:, 2:]).all()
    assert (seen.track_length == 2).sum() > 50


def test_each_camera_tracks_features_of_its_own(painted_rig: StereoRig, painted_pair: Pair) -> None:
    driven = drive(tracker_of(painted_rig, "each"), painted_rig, painted_pair)
    of_left: dict[int, bool] = {}
    for seen in driven:
        left, right = in_left(seen), np.isfinite(seen.pixels[:, 2])
        assert (left ^ right).all()
        assert min(left.sum(), right.sum()) > 80
        assert len(np.unique(seen.feature_id)) == len(seen)
        for k, side in zip(seen.feature_id.tolist(), left.tolist(), strict=True):
            assert of_left.setdefault(k, side) == side
        xy = np.concatenate(
            [painted_rig.cam0.normalize(seen.pixels[:, :2]),
             painted_rig.cam1.normalize(seen.pixels[:, 2:])], axis=1,
        )  # fmt: skip
        np.testing.assert_array_equal(seen.normalized, xy)


def test_right_features_stay_with_their_points(painted_rig: StereoRig, painted_pair: Pair) -> None:
    driven = drive(tracker_of(painted_rig, "each"), painted_rig, painted_pair)
    first, last = driven[0], driven[-1]
    _, a, b = np.intersect1d(first.feature_id, last.feature_id, return_indices=True)
    for columns in (slice(0, 2), slice(2, 4)):
        moved = last.pixels[b, columns] - first.pixels[a, columns]
        moved = moved[np.isfinite(moved[:, 0])]
        expected = FOCAL_PX * STEP_M * (len(driven) - 1) / WALLS_M
        assert len(moved) > 40
        assert np.quantile(np.abs(moved[:, :1] - expected).min(1), 0.8) < 0.3
        assert np.quantile(np.abs(moved[:, 1]), 0.8) < 0.3
    assert (last.track_length[b] == len(driven) - 1).all()
    assert last.two_view_inlier.mean() > 0.9


def test_two_runs_are_equal_bit_for_bit(painted_rig: StereoRig, painted_pair: Pair) -> None:
    runs = [drive(tracker_of(painted_rig, "each"), painted_rig, painted_pair) for _ in range(2)]
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a.feature_id, b.feature_id)
        np.testing.assert_array_equal(a.pixels, b.pixels)


def test_the_search_goes_on_from_two_views_and_the_motion(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the motion predicted, the third frame's search starts at the points; in both cameras."""
    misses: list[FloatArray] = []

    def spy(sought: Sought, view: View, start: FloatArray, *rest: object) -> Found:
        now = find_features(sought, view, start, *rest)  # type: ignore[arg-type]
        misses.append(np.linalg.norm(start - now.uv, axis=1)[now.found])
        return now

    monkeypatch.setattr(klt_tracker, "find_features", spy)
    drive(tracker_of(painted_rig, "each"), painted_rig, painted_pair, n=3)
    _, _, left, right = misses
    assert np.median(misses[0]) > 3.0  # the first time nothing is known
    for miss in (left, right):
        assert np.quantile(miss[: len(miss) // 2], 0.8) < 0.5


@pytest.mark.parametrize("cameras", ["stereo", "left", "each"])
@pytest.mark.parametrize("masked", ["cam0", "cam1", "both"])
def test_nothing_is_taken_from_masked_pixels(
    painted_rig: StereoRig, painted_pair: Pair, cameras: str, masked: str
) -> None:
    """The right half of the left image, the left half of the right one."""
    mask = np.zeros((240, 320), dtype=np.uint8)
    mask[:, 160:] = 1
    flipped = mask[:, ::-1].copy()
    left = None if masked == "cam1" else mask
    right = None if masked == "cam0" else flipped
    driven = drive(
        tracker_of(painted_rig, cameras), painted_rig, painted_pair, n=3, masks=(left, right)
    )
    u = np.concatenate([seen.pixels[:, 0] for seen in driven])
    u_right = np.concatenate([seen.pixels[:, 2] for seen in driven])
    assert np.isfinite(u).sum() > 60
    assert not (left is not None and (u > 160).any())
    assert not (right is not None and (u_right < 159).any())
    assert (u > 165).any() == (left is None)
    if cameras == "each":
        assert np.isfinite(u_right).sum() > 60
        assert (u_right < 154).any() == (right is None)


def test_features_are_no_images(painted_rig: StereoRig) -> None:
    frame = FeatureFrame(7, np.arange(3), np.ones((3, 4)))
    with closing(tracker_of(painted_rig, "each")) as tracker:
        assert isinstance(tracker, MonocularTracker)
        with pytest.raises(OvmotError, match="frame 7: features"):
            tracker.track(frame, np.eye(4), no_feedback(painted_rig))
