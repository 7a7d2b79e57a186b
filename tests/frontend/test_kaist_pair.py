"""The real KAIST pair, with its own calibration, through matching and the epipolar gate."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.interfaces import no_feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import StereoFrame


def test_matches_lie_on_their_epipolar_lines(data_root: Path) -> None:
    folder = data_root / "kaist_sample"
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing")
    sequence = open_sequence(folder)
    np.testing.assert_allclose(sequence.rig.T_imu_cam0[:3, 3], [1.712, 0.247, -0.116], atol=5e-4)
    assert sequence.rig.baseline == pytest.approx(0.4751, abs=5e-5)
    left, right = (
        sequence.decode(paths[0]) for paths in (sequence.left_paths, sequence.right_paths)
    )
    tracker = StereoTracker(sequence.rig, TrackerSettings(), EpipolarSettings())
    try:
        _, matches = tracker.track(
            StereoFrame(0, left, right), np.eye(4), no_feedback(sequence.rig)
        )
    finally:
        tracker.close()
    assert len(matches.distance_px) > 150
    assert np.median(matches.distance_px) < 0.6
    assert matches.accepted.mean() > 0.8
