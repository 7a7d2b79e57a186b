"""The stereo tracker on painted images whose depth and motion are known."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.frontend import klt_tracker, right_search, stereo_tracker
from ovmot.frontend.epipolar import gate_matches
from ovmot.frontend.epipolar_kernel import GatedPairs
from ovmot.frontend.feature_search import Found, Sought, find_features
from ovmot.frontend.preprocessing import View, build_pyramid
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FrontendFrame, Picture, StereoFrame, StereoMatches

TRACKER = TrackerSettings(
    max_features=150, fine_columns=16, fast_threshold=12,
    equalization="none", klt_window_px=13, klt_levels=5, two_view_threshold_px=1.0,
)  # fmt: skip
GATE = EpipolarSettings(threshold_px=1.5, scale="angle")
STEP_M = 0.15

Pair = Callable[..., StereoFrame]
Seen = list[tuple[FrontendFrame, StereoMatches]]


@contextmanager
def tracker_of(rig: StereoRig, settings: TrackerSettings = TRACKER) -> Iterator[StereoTracker]:
    made = StereoTracker(rig, settings, GATE)
    try:
        yield made
    finally:
        made.close()


def sideways(distance: float) -> FloatArray:
    """T_now_before of the left camera when the rig goes `distance` metres to its left."""
    return se3.make(np.eye(3), np.array([distance, 0.0, 0.0]))


def drive(rig: StereoRig, painted_pair: Pair, n: int = 6, lift: int = 0) -> Seen:
    out: Seen = []
    with tracker_of(rig) as tracker:
        for i in range(n):
            frame = painted_pair(10**8 * i, STEP_M * i, 0.0, lift)
            out.append(tracker.track(frame, sideways(STEP_M if i else 0.0), no_feedback(rig)))
    return out


@pytest.fixture(scope="module")
def driven(painted_rig: StereoRig, painted_pair: Pair) -> Seen:
    return drive(painted_rig, painted_pair)


def test_the_first_frame_has_new_corners_with_stereo_matches(driven: Seen) -> None:
    seen, matches = driven[0]
    assert len(seen) > 80
    assert (seen.track_length == 0).all()
    assert seen.two_view_inlier.all()
    both = np.isfinite(seen.pixels[:, 2])
    assert both.mean() > 0.6  # at the image border the right camera sees other things
    disparity = seen.pixels[both, 0] - seen.pixels[both, 2]
    expected = 60.0 / np.array([5.0, 6.0, 8.0])
    near = np.abs(disparity[:, None] - expected).min(1)
    assert np.quantile(near, 0.9) < 0.15
    assert matches.accepted.sum() == both.sum()


def test_positions_are_those_of_the_walls(driven: Seen, painted_rig: StereoRig) -> None:
    for seen, _ in driven:
        p = triangulate_stereo(seen.normalized, painted_rig.T_cam1_cam0)
        u, v = seen.pixels[:, 0], seen.pixels[:, 1]
        clear = np.isfinite(p[:, 2]) & ((u < 90) | (u > 250))
        upper = clear & (v < 105)
        lower = clear & (v > 135)
        assert min(upper.sum(), lower.sum()) > 5
        assert abs(float(np.median(p[upper, 2])) - 8.0) < 0.2
        assert abs(float(np.median(p[lower, 2])) - 5.0) < 0.1


def test_ids_are_unique_and_stay_with_their_point(driven: Seen) -> None:
    for seen, _ in driven:
        assert len(np.unique(seen.feature_id)) == len(seen)
    (first, _), (last, _) = driven[0], driven[-1]
    _, a, b = np.intersect1d(first.feature_id, last.feature_id, return_indices=True)
    u, v = first.pixels[a, 0], first.pixels[a, 1]
    # where one wall covers another a patch holds both, and follows neither
    clear = (np.abs(v - 120.0) > 15.0) & ((u < 100.0) | (u > 215.0))
    a, b = a[clear], b[clear]
    assert len(a) > 30
    moved = last.pixels[b, 0] - first.pixels[a, 0]
    expected = 200.0 * STEP_M * (len(driven) - 1) / np.array([5.0, 6.0, 8.0])
    assert np.quantile(np.abs(moved[:, None] - expected).min(1), 0.95) < 0.3
    assert np.quantile(np.abs(last.pixels[b, 1] - first.pixels[a, 1]), 0.95) < 0.3


def test_new_features_get_ids_never_used_before(driven: Seen) -> None:
    used: set[int] = set()
    alive: set[int] = set()
    for seen, _ in driven:
        ids = set(seen.feature_id.tolist())
        fresh = set(seen.feature_id[seen.track_length == 0].tolist())
        assert fresh == ids - alive
        assert not fresh & used
        used |= ids
        alive = ids


def test_track_lengths_count_the_frames(driven: Seen) -> None:
    born: dict[int, int] = {}
    for i, (seen, _) in enumerate(driven):
        for feature, track_length in zip(
            seen.feature_id.tolist(), seen.track_length.tolist(), strict=True
        ):
            assert track_length == i - born.setdefault(feature, i)
    assert max(seen.track_length.max() for seen, _ in driven) == len(driven) - 1


def test_normalized_coordinates_are_those_of_the_pixels(
    driven: Seen, painted_rig: StereoRig
) -> None:
    for seen, _ in driven:
        np.testing.assert_array_equal(
            seen.normalized[:, :2], painted_rig.cam0.normalize(seen.pixels[:, :2])
        )
        np.testing.assert_array_equal(
            seen.normalized[:, 2:], painted_rig.cam1.normalize(seen.pixels[:, 2:])
        )


def test_two_runs_are_equal_bit_for_bit(
    driven: Seen, painted_rig: StereoRig, painted_pair: Pair
) -> None:
    for (a, am), (b, bm) in zip(driven, drive(painted_rig, painted_pair), strict=True):
        for x, y in (
            (a.feature_id, b.feature_id),
            (a.pixels, b.pixels),
            (a.track_length, b.track_length),
        ):
            np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(a.two_view_inlier, b.two_view_inlier)
        np.testing.assert_array_equal(am.distance_px, bm.distance_px)


def test_a_large_motion_needs_the_prediction(painted_rig: StereoRig, painted_pair: Pair) -> None:
    """40 to 64 px between two frames: found with the predicted motion, lost without."""
    settings = TRACKER.model_copy(update={"klt_levels": 1, "fine_columns": 32})
    share = {}
    for predicted in (0.0, 1.6):
        with tracker_of(painted_rig, settings) as tracker:
            first, _ = tracker.track(painted_pair(0, 0.0), np.eye(4), no_feedback(painted_rig))
            second, _ = tracker.track(
                painted_pair(10**8, 1.6), sideways(predicted), no_feedback(painted_rig)
            )
        in_both = first.pixels[:, 0] < 320 - 75
        kept = np.isin(first.feature_id[in_both], second.feature_id)
        share[predicted] = kept.mean()
    assert share[1.6] > 0.6
    assert share[0.0] < 0.3


def test_a_body_that_moves_by_itself_is_tracked(painted_rig: StereoRig, painted_pair: Pair) -> None:
    """The same patch at the same columns of every image, ten rows lower each time."""
    still = painted_pair(0, 0.0)

    def falling(i: int) -> StereoFrame:
        pair = painted_pair(10**8 * i, STEP_M * i, 0.0)
        left, right = (image.copy() for image in pair.pair)
        first = 50 + 10 * i
        left[first : first + 60, 120:200] = still.left[30:90, 20:100]
        right[first : first + 60, 110:190] = still.left[30:90, 20:100]
        return replace(pair, left=left, right=right)

    with tracker_of(painted_rig) as tracker:
        first, _ = tracker.track(falling(0), np.eye(4), no_feedback(painted_rig))
        for i in range(1, 5):
            seen, _ = tracker.track(falling(i), sideways(STEP_M), no_feedback(painted_rig))
    u, v = seen.pixels[:, 0], seen.pixels[:, 1]
    body = (u > 126) & (u < 194) & (v > 96) & (v < 144) & (seen.track_length == 4)
    assert body.sum() >= 6
    _, a, b = np.intersect1d(first.feature_id, seen.feature_id[body], return_indices=True)
    moved = seen.pixels[body][b, :2] - first.pixels[a, :2]
    # some of what the body covers is found again in its texture, which is of the same kind
    assert (np.abs(moved - [0.0, 40.0]).max(1) < 0.3).mean() > 0.6


def test_the_verdict_of_the_two_view_test_is_passed_on(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    verdicts: list[BoolArray] = []

    def every_third(
        before: FloatArray, now: FloatArray, R_now_before: FloatArray, threshold: float
    ) -> BoolArray:
        np.testing.assert_array_equal(R_now_before, np.eye(3))
        assert threshold == pytest.approx(1.0 / 200.0)
        np.testing.assert_allclose(now[:, 0] - before[:, 0], STEP_M / 8.0, atol=STEP_M / 6.0)
        verdicts.append(np.arange(len(before)) % 3 > 0)
        return verdicts[-1]

    monkeypatch.setattr(klt_tracker, "two_view_inliers", every_third)
    driven = drive(painted_rig, painted_pair)
    assert len(verdicts) == len(driven) - 1
    for (seen, _), verdict in zip(driven[1:], verdicts, strict=True):
        np.testing.assert_array_equal(seen.two_view_inlier[seen.track_length > 0], verdict)
        assert seen.two_view_inlier[seen.track_length == 0].all()


def test_a_rig_displaced_diagonally_is_matched(painted_rig: StereoRig, painted_pair: Pair) -> None:
    """The right camera is 0.3 m to the right and 0.2 m lower: lines at 34 degrees."""
    low = painted_rig.T_imu_cam1.copy()
    low[2, 3] -= 0.2
    rig = replace(painted_rig, T_imu_cam1=low)
    flat = painted_pair(0, 0.0)
    right = flat.pair[1].copy()
    right[:112] = np.roll(flat.pair[1], -5, axis=0)[:112]  # 200 · 0.2 / 8 px for the upper wall
    right[112:] = np.roll(flat.pair[1], -8, axis=0)[112:]  # 200 · 0.2 / 5 px for the lower one
    with tracker_of(rig) as tracker:
        seen, matches = tracker.track(StereoFrame(0, flat.left, right), np.eye(4), no_feedback(rig))
    slope = matches.line[:, 0] / matches.line[:, 1]
    np.testing.assert_allclose(np.abs(slope), 2.0 / 3.0, atol=1e-9)
    u, v = seen.pixels[:, 0], seen.pixels[:, 1]
    clear = ((u < 90) | (u > 250)) & (u > 30) & (np.abs(v - 120) > 20)
    assert np.isfinite(seen.pixels[clear, 2]).mean() > 0.85


def test_no_rejected_match_leaves_the_tracker(painted_rig: StereoRig, painted_pair: Pair) -> None:
    """A part of the right image stands 3 px too high: what is matched there is rejected."""
    driven = drive(painted_rig, painted_pair, lift=3)
    n_rejected = 0
    for seen, matches in driven:
        rejected = matches.feature_id[~matches.accepted]
        n_rejected += len(rejected)
        row = np.searchsorted(np.sort(seen.feature_id), rejected)
        row = np.argsort(seen.feature_id)[row]
        assert np.isnan(seen.pixels[row, 2:]).all()
        assert np.isnan(seen.normalized[row, 2:]).all()
        tested = matches.pixels[~matches.accepted]
        np.testing.assert_array_equal(seen.pixels[row, :2], tested[:, :2])  # the left lives on
        assert np.median(matches.distance_px[~matches.accepted]) == pytest.approx(3.0, abs=0.6)
        paired = np.isfinite(seen.pixels[:, 2])
        assert set(seen.feature_id[paired]) == set(matches.feature_id[matches.accepted])
    assert n_rejected > 40
    # as a monocular track: rejected again and again, and tracked all the same
    last, matches = driven[-1]
    rejected_now = np.isin(last.feature_id, matches.feature_id[~matches.accepted])
    assert last.track_length[rejected_now].max() == len(driven) - 1


def test_a_rejected_match_gives_no_depth_to_the_next_frame(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[BoolArray] = []

    def spy(*args: Any) -> tuple[GatedPairs, StereoMatches]:
        gated, matches = gate_matches(*args)
        used.append(np.isfinite(gated.p_cam0[gated.tested, 2]))
        return gated, matches

    monkeypatch.setattr(stereo_tracker, "gate_matches", spy)
    driven = drive(painted_rig, painted_pair, lift=3)
    assert len(used) == len(driven)
    placed = np.concatenate(used)
    accepted = np.concatenate([matches.accepted for _, matches in driven])
    assert (~accepted).sum() > 40
    assert placed.sum() > 40
    assert not (placed & ~accepted).any()


def test_wrong_matches_of_any_kind_are_rejected(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search in the right image itself gives wrong points: every fifth one, 9 px off."""
    frames = [painted_pair(10**8 * i, STEP_M * i) for i in range(4)]
    rights = [build_pyramid(frame.pair[1], TRACKER).levels[0] for frame in frames]

    def lying(sought: Sought, view: View, start: FloatArray, *rest: object) -> Found:
        now = find_features(sought, view, start, *rest)  # type: ignore[arg-type]
        if any(np.array_equal(view.pyramid.levels[0], right) for right in rights):
            now.uv[::5, 1] += 9.0
        return now

    monkeypatch.setattr(right_search, "find_features", lying)
    with tracker_of(painted_rig) as tracker:
        for i, frame in enumerate(frames):
            seen, matches = tracker.track(
                frame, sideways(STEP_M if i else 0.0), no_feedback(painted_rig)
            )
            assert np.isnan(seen.pixels[::5, 2:]).all()
            assert np.isnan(seen.normalized[::5, 2:]).all()
            assert np.isfinite(seen.pixels[::5, :2]).all()
            assert np.isfinite(seen.pixels[1::5, 2:]).mean() > 0.5
            wrong = np.isin(matches.feature_id, seen.feature_id[::5])
            assert wrong.sum() > 5
            assert not matches.accepted[wrong].any()


def test_nothing_is_taken_from_masked_pixels(painted_rig: StereoRig, painted_pair: Pair) -> None:
    mask = np.zeros((240, 320), dtype=np.uint8)
    mask[:, 160:] = 1
    unmasked_frames = 2
    with tracker_of(painted_rig) as tracker:
        for i in range(6):
            frame = painted_pair(10**8 * i, STEP_M * i, 0.0, 0)
            if i >= unmasked_frames:
                frame = replace(frame, left_mask=mask, right_mask=mask[:, ::-1].copy())
            seen, matches = tracker.track(
                frame, sideways(STEP_M if i else 0.0), no_feedback(painted_rig)
            )
            right = seen.pixels[np.isfinite(seen.pixels[:, 2]), 2]
            if i < unmasked_frames:
                assert (seen.pixels[:, 0] > 165).any()
                continue
            assert len(seen) > 20
            assert (seen.pixels[:, 0] < 160).all()
            assert (right > 159).all()
            assert (matches.pixels[:, 0] < 160).all()


def test_matches_are_checked_by_the_calibration_of_the_moment(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    turned = painted_rig.T_imu_cam1 @ se3.make(so3.exp(np.array([0.05, 0.0, 0.0])), np.zeros(3))
    with tracker_of(painted_rig) as tracker:
        _, right = tracker.track(painted_pair(0, 0.0, 0.0, 0), np.eye(4), no_feedback(painted_rig))
        feedback = no_feedback(replace(painted_rig, T_imu_cam1=turned))
        _, wrong = tracker.track(painted_pair(1, 0.0, 0.0, 0), np.eye(4), feedback)
    assert right.accepted.mean() > 0.9
    assert wrong.accepted.mean() < 0.1


def drive_without(
    rig: StereoRig, painted_pair: Pair, side: int, first: int, last: int, n: int = 9
) -> Seen:
    """A drive whose frames `first` to `last` have no picture of one camera."""
    out: Seen = []
    with tracker_of(rig) as tracker:
        for i in range(n):
            frame = painted_pair(10**8 * i, STEP_M * i, 0.0)
            if first <= i <= last:
                black = np.zeros_like(frame.left)
                left, right = (black, frame.right) if side == 0 else (frame.left, black)
                frame = replace(frame, left=left, right=right, missing=(side,))
            out.append(tracker.track(frame, sideways(STEP_M if i else 0.0), no_feedback(rig)))
    return out


def test_without_a_right_picture_the_left_one_goes_on(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    driven = drive_without(painted_rig, painted_pair, 1, 3, 5)
    for i in range(3, 6):
        seen, matches = driven[i]
        assert seen.pictures == (Picture.FINE, Picture.MISSING)
        assert np.isnan(seen.pixels[:, 2:]).all() and np.isfinite(seen.pixels[:, :2]).all()
        assert len(matches.feature_id) == 0
    before, after = driven[2][0], driven[6][0]
    assert np.isin(before.feature_id, after.feature_id).mean() > 0.6
    assert np.isfinite(after.pixels[:, 2]).mean() > 0.6


def test_without_a_left_picture_the_right_one_goes_on(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    driven = drive_without(painted_rig, painted_pair, 0, 3, 5)
    for i in range(3, 6):
        seen, matches = driven[i]
        assert seen.pictures == (Picture.MISSING, Picture.FINE)
        assert np.isnan(seen.pixels[:, :2]).all() and np.isfinite(seen.pixels[:, 2:]).all()
        assert len(seen) > 60 and len(matches.feature_id) == 0
        # the features that the right camera had seen stay where they are
        known, a, b = np.intersect1d(seen.feature_id, driven[2][0].feature_id, return_indices=True)
        assert len(known) > 40
        moved = seen.pixels[a, 2] - driven[2][0].pixels[b, 2]
        expected = STEP_M * (i - 2) * 200.0 / np.array([5.0, 6.0, 8.0])
        assert np.quantile(np.abs(moved[:, None] - expected).min(1), 0.8) < 0.5
    # the left camera goes on where it was, with stereo matches again
    before, after = driven[2][0], driven[6][0]
    assert np.isin(before.feature_id, after.feature_id).mean() > 0.4
    assert np.isfinite(after.pixels[:, 2]).mean() > 0.6


def test_without_any_picture_nothing_is_seen(painted_rig: StereoRig, painted_pair: Pair) -> None:
    with tracker_of(painted_rig) as tracker:
        frame = painted_pair(0, 0.0, 0.0)
        tracker.track(frame, np.eye(4), no_feedback(painted_rig))
        black = np.zeros_like(frame.left)
        dark = StereoFrame(10**8, black, black)
        seen, matches = tracker.track(dark, np.eye(4), no_feedback(painted_rig))
        assert len(seen) == 0 and len(matches.feature_id) == 0
        assert seen.pictures == (Picture.FLAT, Picture.FLAT)


def test_what_repeats_itself_along_the_lines_is_not_matched(painted_rig: StereoRig) -> None:
    """Columns that come again every 24 pixels, seen 8 pixels apart: near the left border, where one
    place alone is in the right image, there is a match, and it is right."""
    rng = np.random.default_rng(8)
    tile = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (240, 24)), (0, 0), 1.5)
    wall = np.tile(np.clip(128.0 + 4.0 * (tile - 128.0), 0.0, 255.0).astype(np.uint8), 15)
    frame = StereoFrame(0, wall[:, :320].copy(), wall[:, 8:328].copy())
    disparity = {}
    for search in ("scan", "flow"):
        settings = TRACKER.model_copy(update={"stereo_search": search})
        with tracker_of(painted_rig, settings) as tracker:
            seen, _ = tracker.track(frame, np.eye(4), no_feedback(painted_rig))
        matched = seen.pixels[np.isfinite(seen.pixels[:, 2])]
        disparity[search] = matched[:, 0] - matched[:, 2]
    assert len(disparity["flow"]) > 5 * len(disparity["scan"]) > 25
    np.testing.assert_allclose(disparity["scan"], 8.0, atol=0.2)
