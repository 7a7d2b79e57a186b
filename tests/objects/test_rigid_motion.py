"""Rigid motions of grouped points, and the earlier frame to compare with."""

from collections.abc import Callable

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.clustering import MotionHistory
from ovmot.objects.rigid_motion import best_row, extract_motions
from ovmot.settings import ObjectSettings

SETTINGS = ObjectSettings()


def test_one_group_of_two_motions_gives_both(
    history_of: Callable[..., MotionHistory], rig: StereoRig
) -> None:
    history = history_of([(12.0, 0.8, (8.0, 0.0, 0.0), 18), (12.0, -0.8, (5.0, 0.0, 0.0), 12)])
    everything = np.arange(len(history.feature_id))
    found = extract_motions(history, everything, rig, SETTINGS, np.random.default_rng(3))
    assert len(found) == 2
    ids = [set(history.feature_id[g.index].tolist()) for g in found]
    assert len(ids[0] & set(range(100, 118))) >= 16 and len(ids[0] - set(range(100, 118))) <= 2
    assert len(ids[1] & set(range(118, 130))) >= 9
    again = extract_motions(history, everything, rig, SETTINGS, np.random.default_rng(3))
    np.testing.assert_array_equal(found[0].T_now_then, again[0].T_now_then)


def test_points_on_a_line_give_their_translation(
    history_of: Callable[..., MotionHistory], rig: StereoRig, drive: Callable[..., FloatArray]
) -> None:
    history = history_of([(30.0, 0.0, (2.0, 7.0, 0.0), 3)], seed=2)
    everything = np.arange(3)
    (found,) = extract_motions(history, everything, rig, SETTINGS, np.random.default_rng(0))
    np.testing.assert_array_equal(found.T_now_then[:3, :3], np.eye(3))
    span = history.history.span_s[found.row]
    R = (drive(12)[-1] @ rig.T_imu_cam0)[:3, :3]
    np.testing.assert_allclose(
        (R @ found.T_now_then[:3, 3])[1] / span, 7.0, atol=0.5
    )  # across the ray


def test_the_span_grows_with_the_noise_and_shrinks_with_acceleration(
    history_of: Callable[..., MotionHistory],
) -> None:
    near = history_of([(8.0, 0.0, (6.0, 0.0, 0.0), 30)])
    far = history_of([(38.0, 0.0, (6.0, 2.0, 0.0), 4)])
    index = np.arange(3)
    span = near.history.span_s
    assert span[best_row(near, index, 0.0)] >= 0.7
    assert span[best_row(near, index, 3.0)] < span[best_row(far, index, 3.0)]
