"""What a frame shows the bodies: how fast the rig turns."""

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.objects.frame_views import turn_rate_rps
from ovmot.types import PoseWindow


def test_the_turn_rate_is_that_of_the_newest_two_poses() -> None:
    rng = np.random.default_rng(1)
    first, second = se3.exp(rng.normal(0.0, 1.0, (2, 6)))
    axis = np.array([0.6, 0.0, 0.8])
    third = second @ se3.exp(np.concatenate([0.05 * axis, [1.0, 2.0, 3.0]]))
    stamps = np.array([0, 200_000_000, 300_000_000])
    poses = np.stack([first, second, third])
    assert turn_rate_rps(PoseWindow(stamps, poses, np.zeros((18, 18)))) == pytest.approx(0.5)
    assert turn_rate_rps(PoseWindow(stamps[:1], poses[:1], np.zeros((6, 6)))) == 0.0
