"""Points are grouped by place, motion and the depth noise of stereo."""

from collections.abc import Callable

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.clustering import MotionHistory, group_points
from ovmot.settings import ObjectSettings

SETTINGS = ObjectSettings()


def _ids(history: MotionHistory, settings: ObjectSettings = SETTINGS) -> list[set[int]]:
    index, size = group_points(history, settings)
    groups = np.split(history.feature_id[index], np.cumsum(size)[:-1])
    return [set(g.tolist()) for g in groups]


def test_velocities_of_points_are_consistent(
    history_of: Callable[..., MotionHistory], rig: StereoRig, drive: Callable[..., FloatArray]
) -> None:
    velocity = (6.0, -2.0, 0.0)
    history = history_of([(14.0, 0.0, velocity, 60)])
    R = (drive(12)[-1] @ rig.T_imu_cam0)[:3, :3]
    e = history.velocity - R.T @ np.array(velocity)
    distance = (e * np.linalg.solve(history.velocity_cov, e[..., None])[..., 0]).sum(-1)
    assert len(history.feature_id) >= 58
    # 3 would be right; all rows have the present observation in common, which is not modelled
    assert 1.5 < np.mean(distance) < 5.0


def test_apart_in_place_or_in_motion(history_of: Callable[..., MotionHistory]) -> None:
    far = history_of([(14.0, 4.0, (6.0, 0.0, 0.0), 20), (14.0, -4.0, (6.0, 0.0, 0.0), 15)])
    assert len(_ids(far)) == 2
    crossing = history_of([(14.0, 1.0, (6.0, 0.0, 0.0), 20), (14.0, -1.0, (-6.0, 0.0, 0.0), 15)])
    first, second = _ids(crossing)
    assert first <= set(range(100, 120)) and second <= set(range(120, 135))
    assert len(first) >= 18 and len(second) >= 13


def test_a_distant_body_stays_one_though_its_depths_scatter(
    history_of: Callable[..., MotionHistory],
) -> None:
    # at 38 m one pixel's disparity is 7 m: depths scatter by 3 m
    for seed in range(5):
        history = history_of([(38.0, 0.0, (3.0, 8.0, 0.0), 12)], seed)
        assert max(len(group) for group in _ids(history)) >= 10


def test_fewer_points_than_asked_are_no_group(history_of: Callable[..., MotionHistory]) -> None:
    history = history_of(
        [(14.0, 3.0, (6.0, 0.0, 0.0), 3), (14.0, -6.0, (0.0, 5.0, 0.0), 6)], 0, (1.0,) * 3
    )
    assert sorted(len(g) for g in _ids(history)) == [3, 6]
    strict = SETTINGS.model_copy(update={"min_points": 4})
    assert [len(g) for g in _ids(history, strict)] == [6]
    assert history_of([(14.0, 3.0, (6.0, 0.0, 0.0), 2)]) is None
