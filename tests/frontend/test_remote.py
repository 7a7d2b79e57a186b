"""The front end in another process: the same features, errors that come through, an end."""

import os
import signal
from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend.remote import RemoteFrontEnd
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, StereoFrame

Pair = Callable[..., StereoFrame]


def test_it_finds_the_features_of_the_front_end_here(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    here = StereoTracker(painted_rig, TrackerSettings(), EpipolarSettings())
    there = RemoteFrontEnd(painted_rig, TrackerSettings(), EpipolarSettings())
    try:
        for i in range(3):
            frame = painted_pair(10**8 * i, 0.1 * i)
            told = frame, np.eye(4), no_feedback(painted_rig)
            (seen, matches), (seen_there, matches_there, _) = (
                here.track(*told),
                there.begin(*told)(),
            )
            np.testing.assert_array_equal(seen.pixels, seen_there.pixels)
            np.testing.assert_array_equal(seen.feature_id, seen_there.feature_id)
            np.testing.assert_array_equal(matches.distance_px, matches_there.distance_px)
            assert len(seen.feature_id) > 40
    finally:
        there.close()
    there.close()


def test_an_error_comes_through_and_the_next_frame_is_tracked(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    there = RemoteFrontEnd(painted_rig, TrackerSettings(), EpipolarSettings())
    told = np.eye(4), no_feedback(painted_rig)
    with pytest.raises(OvmotError, match="features where images were expected"):
        there.begin(FeatureFrame(5, np.array([1]), np.zeros((1, 4))), *told)()
    seen, _, _ = there.begin(painted_pair(7, 0.0), *told)()
    assert len(seen.feature_id) > 40
    there.close()


def test_a_process_that_dies_is_said(painted_rig: StereoRig, painted_pair: Pair) -> None:
    there = RemoteFrontEnd(painted_rig, TrackerSettings(), EpipolarSettings())
    os.kill(there._process.pid, signal.SIGKILL)
    there._process.wait()
    with pytest.raises(OvmotError, match="process has ended"):
        there.begin(painted_pair(7, 0.0), np.eye(4), no_feedback(painted_rig))()
    there.close()


def test_two_frames_are_in_flight_and_answered_in_order(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    here = StereoTracker(painted_rig, TrackerSettings(), EpipolarSettings())
    there = RemoteFrontEnd(painted_rig, TrackerSettings(), EpipolarSettings())
    told = np.eye(4), no_feedback(painted_rig)
    frames = [painted_pair(10**8 * i, 0.1 * i) for i in range(6)]
    try:
        waiting = there.begin(frames[0], *told)
        for frame, after in zip(frames, [*frames[1:], None], strict=True):
            answer = waiting
            if after is not None:  # its pictures must not take the place of those worked on
                waiting = there.begin(after, *told)
            seen, _ = here.track(frame, *told)
            np.testing.assert_array_equal(answer().seen.pixels, seen.pixels)
            assert seen.timestamp_ns == frame.timestamp_ns
    finally:
        there.close()
