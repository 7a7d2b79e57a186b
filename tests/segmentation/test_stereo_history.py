"""The history of a frame: which times it looks back to, and what it holds of each feature."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory, append_frame, empty_table
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import stereo_covariance, triangulate_stereo
from ovmot.segmentation.stereo_history import look_back_rows, stereo_history
from ovmot.types import FrontendFrame, PixelNoise, PoseWindow

NOISE = PixelNoise(0.4, 0.4, 0.15, 0.01)
SPANS = (1.0, 0.5, 0.2)
N_FRAMES, N_POINTS = 16, 12
Recorded = tuple[FeatureTable, PoseWindow, FloatArray]


@pytest.fixture
def recorded(
    rig: StereoRig, drive: Callable[..., FloatArray], measure: Callable[..., FloatArray],
    in_view: Callable[..., FloatArray], window_of: Callable[..., PoseWindow],
) -> Recorded:  # fmt: skip
    """16 frames at 10 Hz of twelve points, ids from 100 on, in another order in each frame."""
    rng = np.random.default_rng(4)
    T = drive(N_FRAMES)
    m = measure(rig, T, in_view(rig, T, N_POINTS, (6.0, 30.0), rng), 0.3, rng)
    window, table = window_of(T), empty_table()
    for k, stamp in enumerate(window.timestamp_ns.tolist()):
        order = np.roll(np.arange(N_POINTS), k)
        seen = FrontendFrame(
            stamp, 100 + order, m[k, order], m[k, order], np.full(N_POINTS, k),
            np.ones(N_POINTS, dtype=np.bool_),
        )  # fmt: skip
        table = append_frame(table, seen)
    return table, window, m


def history_of(recorded: Recorded, rig: StereoRig) -> StereoHistory:
    table, window, _ = recorded
    ids = 100 + np.arange(N_POINTS)[::-1]
    return stereo_history(table, ids, window.timestamp_ns, rig, SPANS, NOISE)


def test_it_looks_back_to_the_frames_nearest_to_the_times_and_the_last(
    recorded: Recorded, rig: StereoRig
) -> None:
    history = history_of(recorded, rig)
    assert history.row.tolist() == [5, 10, 13, 14]  # 1.0, 0.5, 0.2 and 0.1 s ago
    np.testing.assert_allclose(history.span_s, [1.0, 0.5, 0.2, 0.1])
    assert history.n_frames.tolist() == [10, 5, 2, 1]
    assert len(history) == 4


def test_only_frames_with_a_known_pose_count(recorded: Recorded) -> None:
    table, window, _ = recorded
    known = np.delete(window.timestamp_ns, [5, 14])
    assert look_back_rows(table, known, (1.0, 0.1)).tolist() == [4, 13]  # 1.1 s is near enough
    assert look_back_rows(table, window.timestamp_ns[-1:], SPANS).tolist() == []
    assert look_back_rows(table, window.timestamp_ns[12:], (1.0,)).tolist() == [14]


def test_positions_and_covariances_are_those_of_the_pairs(
    recorded: Recorded, rig: StereoRig
) -> None:
    history, m = history_of(recorded, rig), recorded[2]
    then = m[history.row][:, ::-1]
    np.testing.assert_array_equal(history.then, then)
    p = triangulate_stereo(then, rig.T_cam1_cam0)
    np.testing.assert_allclose(history.p_then, p, rtol=1e-10)
    now = triangulate_stereo(m[-1, ::-1], rig.T_cam1_cam0)
    np.testing.assert_allclose(history.p_now, now, rtol=1e-10)
    C = stereo_covariance(now, rig.T_cam1_cam0, rig.normalized_sigma(NOISE.sigma_px))
    np.testing.assert_allclose(history.cov_now, C, rtol=1e-7, atol=1e-12)


def test_some_features_and_younger_frames(recorded: Recorded, rig: StereoRig) -> None:
    history = history_of(recorded, rig)
    some = history.only(np.array([3, 1]))
    assert some.feature_id.tolist() == [108, 110]
    np.testing.assert_array_equal(some.p_then, history.p_then[:, [3, 1]])
    np.testing.assert_array_equal(some.cov_now, history.cov_now[[3, 1]])
    assert history.younger(0.5).row.tolist() == [10, 13, 14]
    np.testing.assert_array_equal(history.younger(0.5).p_then, history.p_then[1:])


def test_a_random_walk_of_the_patch() -> None:
    np.testing.assert_allclose(NOISE.drift_sigma_px(np.array([1, 4, 16])), [0.15, 0.3, 0.6])
