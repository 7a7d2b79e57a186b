"""Rigid motions of grouped points, and the earlier frame to compare with."""

from collections.abc import Callable

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.clustering import MotionHistory
from ovmot.objects.rigid_kernel import best_row
from ovmot.objects.rigid_motion import extract_motions
from ovmot.settings import ObjectSettings

SETTINGS = ObjectSettings()


def test_one_group_of_two_motions_gives_both(
    history_of: Callable[..., MotionHistory], rig: StereoRig
) -> None:
    history = history_of([(12.0, 0.8, (8.0, 0.0, 0.0), 18), (12.0, -0.8, (5.0, 0.0, 0.0), 12)])
    n = np.array([len(history.feature_id)])
    everything = np.arange(n[0])
    found = extract_motions(history, everything, n, rig, SETTINGS, np.random.default_rng(3))
    assert len(found.size) == 2 and found.group.tolist() == [0, 0]
    both = np.split(history.feature_id[found.point], found.size[:1])
    ids = [set(own.tolist()) for own in both]
    assert len(ids[0] & set(range(100, 118))) >= 16 and len(ids[0] - set(range(100, 118))) <= 2
    assert len(ids[1] & set(range(118, 130))) >= 9
    again = extract_motions(history, everything, n, rig, SETTINGS, np.random.default_rng(3))
    np.testing.assert_array_equal(found.T_now_then, again.T_now_then)


def test_points_on_a_line_give_their_translation(
    history_of: Callable[..., MotionHistory], rig: StereoRig, drive: Callable[..., FloatArray]
) -> None:
    history = history_of([(30.0, 0.0, (2.0, 7.0, 0.0), 3)], seed=2)
    everything, n = np.arange(3), np.array([3])
    found = extract_motions(history, everything, n, rig, SETTINGS, np.random.default_rng(0))
    (T_now_then,) = found.T_now_then
    np.testing.assert_array_equal(T_now_then[:3, :3], np.eye(3))
    span = history.history.span_s[found.row[0]]
    R = (drive(12)[-1] @ rig.T_imu_cam0)[:3, :3]
    across = (R @ T_now_then[:3, 3])[1]
    np.testing.assert_allclose(across / span, 7.0, atol=0.5)


def test_the_span_grows_with_the_noise_and_shrinks_with_acceleration(
    history_of: Callable[..., MotionHistory],
) -> None:
    near = history_of([(8.0, 0.0, (6.0, 0.0, 0.0), 30)])
    far = history_of([(38.0, 0.0, (6.0, 2.0, 0.0), 4)])
    index = np.arange(3)
    span = near.history.span_s

    def best_span(points: MotionHistory, accel_mps2: float) -> float:
        row = best_row(points.weight, points.information, index, span, accel_mps2)
        return float(span[row])

    assert best_span(near, 0.0) >= 0.7
    assert best_span(near, 3.0) < best_span(far, 3.0)
