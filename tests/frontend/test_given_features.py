"""Given features go through the checks that tracked ones go through."""

from typing import get_args

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend import FRONT_ENDS
from ovmot.frontend.given_features import ARRANGEMENTS, GivenFeatures
from ovmot.geometry.arrays import FloatArray
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, StereoFrame


@pytest.fixture
def frontend(painted_rig: StereoRig) -> GivenFeatures:
    return GivenFeatures(painted_rig, TrackerSettings(), EpipolarSettings())


def grid(rig: StereoRig, shift_px: float) -> FloatArray:
    """30 points 6 m away, as pixels (30, 4), moved sideways."""
    u, v = np.meshgrid(np.linspace(60, 280, 6), np.linspace(20, 220, 5))
    left = np.stack([u.ravel() + shift_px, v.ravel()], axis=-1)
    return np.concatenate([left, left - [200.0 * 0.3 / 6.0, 0.0]], axis=1)


def test_a_match_off_its_line_loses_its_right_half(
    frontend: GivenFeatures, painted_rig: StereoRig
) -> None:
    pixels = grid(painted_rig, 0.0)
    pixels[4, 3] += 5.0
    pixels[7, 2:] = np.nan
    seen, matches = frontend.track(
        FeatureFrame(0, np.arange(30), pixels), np.eye(4), no_feedback(painted_rig)
    )
    assert len(matches.feature_id) == 29
    assert matches.feature_id[~matches.accepted].tolist() == [4]
    assert np.flatnonzero(np.isnan(seen.pixels[:, 2])).tolist() == [4, 7]
    assert np.isnan(seen.normalized[4, 2:]).all()
    assert np.isfinite(seen.pixels[:, :2]).all()


def test_track_lengths_count_frames_and_a_stray_track_fails_the_two_view_test(
    frontend: GivenFeatures, painted_rig: StereoRig
) -> None:
    rng = np.random.default_rng(0)
    depth_shift = rng.uniform(2.0, 8.0, 30)  # a translation: points at different depths
    first = grid(painted_rig, 0.0)
    second = first.copy()
    second[:, 0] += depth_shift
    second[3, 1] += 9.0
    second[:, 2:] = np.nan
    frontend.track(FeatureFrame(0, np.arange(30), first), np.eye(4), no_feedback(painted_rig))
    ids = np.arange(31)
    pixels = np.concatenate([second, [[100.0, 100.0, np.nan, np.nan]]])
    seen, _ = frontend.track(
        FeatureFrame(1, ids[::-1], pixels[::-1]), np.eye(4), no_feedback(painted_rig)
    )
    track_length = dict(zip(seen.feature_id.tolist(), seen.track_length.tolist(), strict=True))
    assert track_length.pop(30) == 0
    assert set(track_length.values()) == {1}
    assert seen.feature_id[~seen.two_view_inlier].tolist() == [3]


def test_images_are_rejected(frontend: GivenFeatures, painted_rig: StereoRig) -> None:
    image = np.zeros((240, 320), dtype=np.uint8)
    with pytest.raises(OvmotError, match="frame 7: images"):
        frontend.track(StereoFrame(7, image, image), np.eye(4), no_feedback(painted_rig))


def of(rig: StereoRig, cameras: str) -> GivenFeatures:
    settings = TrackerSettings.model_validate({"cameras": cameras})
    return GivenFeatures(rig, settings, EpipolarSettings())


def test_the_left_camera_alone_leaves_the_right_halves(painted_rig: StereoRig) -> None:
    pixels = grid(painted_rig, 0.0)
    seen, matches = of(painted_rig, "left").track(
        FeatureFrame(0, np.arange(30), pixels), np.eye(4), no_feedback(painted_rig)
    )
    np.testing.assert_array_equal(seen.pixels[:, :2], pixels[:, :2])
    assert np.isnan(seen.pixels[:, 2:]).all()
    assert len(matches.feature_id) == 0


def test_each_camera_by_itself_separates_the_pairs(painted_rig: StereoRig) -> None:
    """And each camera's tracks are tested by its own two views."""
    rng = np.random.default_rng(1)
    first = grid(painted_rig, 0.0)
    second = first.copy()
    second[:, [0, 2]] += rng.uniform(2.0, 8.0, 30)[:, None]
    second[3, 1] += 9.0  # the left view of one point, the right view of another one
    second[5, 3] += 9.0
    second[7, :2] = np.nan  # only the right camera sees it
    frontend = of(painted_rig, "each")
    frontend.track(FeatureFrame(0, np.arange(30), first), np.eye(4), no_feedback(painted_rig))
    seen, matches = frontend.track(
        FeatureFrame(1, np.arange(30), second), np.eye(4), no_feedback(painted_rig)
    )
    assert len(matches.feature_id) == 0
    left = np.isfinite(seen.pixels[:, 0])
    assert seen.feature_id[left].tolist() == [2 * k for k in range(30) if k != 7]
    assert seen.feature_id[~left].tolist() == [2 * k + 1 for k in range(30)]
    np.testing.assert_array_equal(seen.pixels[~left, 2:], second[:, 2:])
    assert (seen.track_length == 1).all()
    assert sorted(seen.feature_id[~seen.two_view_inlier].tolist()) == [6, 11]


def test_every_choice_of_cameras_is_there_for_images_and_given_features() -> None:
    choices = get_args(TrackerSettings.model_fields["cameras"].annotation)
    assert set(choices) == set(FRONT_ENDS) == set(ARRANGEMENTS)
