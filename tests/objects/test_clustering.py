"""Points are grouped by place, motion and the depth noise of stereo."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.clustering import MotionHistory, group_points, motion_history
from ovmot.objects.rigid_motion import best_row, extract_motions
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.settings import ObjectSettings, SegmentationSettings
from ovmot.types import PixelNoise, PoseWindow, ScenePoints

TOLD = ObjectSettings()
NOISE = PixelNoise(0.3, 0.0, 0.0)
Scene = tuple[FeatureTable, ScenePoints, PoseWindow]
Bodies = list[tuple[float, float, tuple[float, float, float], int]]


@pytest.fixture(scope="module")
def history_of(
    rig: StereoRig, drive: Callable[..., FloatArray], body: Callable[..., FloatArray],
    scene_of: Callable[..., Scene],
) -> Callable[..., MotionHistory | None]:  # fmt: skip
    """The history of bodies (ahead, left, velocity, points) as 12 frames show it."""

    def make(
        bodies: Bodies, seed: int = 0, size: tuple[float, float, float] = (4.0, 1.8, 1.4)
    ) -> MotionHistory | None:
        rng = np.random.default_rng(seed)
        T = drive(12)
        parts = [
            body(12, n, se3.apply(T[-1], np.array([ahead, left, 0.0])), np.array(v), 0.0, rng, size)
            for ahead, left, v, n in bodies
        ]
        table, points, window = scene_of(rig, T, np.concatenate(parts, axis=1), 0.3, rng)
        history = stereo_history(
            table, points.feature_id, window.timestamp_ns, rig,
            SegmentationSettings().look_back_s, NOISE,
        )  # fmt: skip
        return motion_history(history.younger(1.0), points, window, rig, TOLD, 60.0)

    return make


def _ids(history: MotionHistory, settings: ObjectSettings = TOLD) -> list[set[int]]:
    return [set(history.feature_id[g].tolist()) for g in group_points(history, settings)]


def test_velocities_of_points_are_consistent(
    history_of: Callable[..., MotionHistory], rig: StereoRig, drive: Callable[..., FloatArray]
) -> None:
    velocity = (6.0, -2.0, 0.0)
    history = history_of([(14.0, 0.0, velocity, 60)])
    R = (drive(12)[-1] @ rig.T_imu_cam0)[:3, :3]
    e = history.velocity - R.T @ np.array(velocity)
    distance = (e * np.linalg.solve(history.velocity_cov, e[..., None])[..., 0]).sum(-1)
    assert len(history.feature_id) >= 58
    # 3 would be right; all rows have the present sighting in common, which is not told
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
    strict = TOLD.model_copy(update={"min_points": 4})
    assert [len(g) for g in _ids(history, strict)] == [6]
    assert history_of([(14.0, 3.0, (6.0, 0.0, 0.0), 2)]) is None


def test_one_group_of_two_motions_gives_both(
    history_of: Callable[..., MotionHistory], rig: StereoRig
) -> None:
    history = history_of([(12.0, 0.8, (8.0, 0.0, 0.0), 18), (12.0, -0.8, (5.0, 0.0, 0.0), 12)])
    everything = np.arange(len(history.feature_id))
    found = extract_motions(history, everything, rig, TOLD, np.random.default_rng(3))
    assert len(found) == 2
    ids = [set(history.feature_id[g.index].tolist()) for g in found]
    assert len(ids[0] & set(range(100, 118))) >= 16 and len(ids[0] - set(range(100, 118))) <= 2
    assert len(ids[1] & set(range(118, 130))) >= 9
    again = extract_motions(history, everything, rig, TOLD, np.random.default_rng(3))
    np.testing.assert_array_equal(found[0].T_now_then, again[0].T_now_then)


def test_points_on_a_line_give_their_translation(
    history_of: Callable[..., MotionHistory], rig: StereoRig, drive: Callable[..., FloatArray]
) -> None:
    history = history_of([(30.0, 0.0, (2.0, 7.0, 0.0), 3)], seed=2)
    everything = np.arange(3)
    (found,) = extract_motions(history, everything, rig, TOLD, np.random.default_rng(0))
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
