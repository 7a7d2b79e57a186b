import numpy as np
import pytest

from ovmot.evaluation.standstill import standing_intervals, standstill_drift
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray

SECOND = 1_000_000_000


def stop_and_go(noise: float = 0.0) -> tuple[IntArray, FloatArray]:
    """10 s at 100 Hz: stands 3 s, drives 2 s at 5 m/s, stands 3 s while turning for 1 s of it."""
    time = np.arange(1001) * 0.01
    x = 5.0 * np.clip(time - 3.0, 0.0, 2.0)
    yaw = 0.5 * np.clip(time - 6.5, 0.0, 1.0)
    rng = np.random.default_rng(0)
    position = np.stack([x, 0.0 * x, 0.0 * x], axis=-1) + rng.normal(0.0, noise, (1001, 3))
    turn = np.stack([0.0 * yaw, 0.0 * yaw, yaw], axis=-1)
    return np.round(time * SECOND).astype(np.int64), se3.make(so3.exp(turn), position)


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_intervals_are_where_nothing_moves(noise: float) -> None:
    found = standing_intervals(*stop_and_go(noise))
    seconds = np.array(found) / SECOND
    np.testing.assert_allclose(seconds, [[0.0, 3.0], [5.0, 6.5], [7.5, 10.0]], atol=0.12)
    for start, end in seconds:  # never into the motion
        assert not (start < 5.0 and end > 3.0)


def test_short_stops_and_paths_of_one_pose_have_none() -> None:
    stamps, T = stop_and_go()
    assert len(standing_intervals(stamps, T, min_duration_s=2.0)) == 2
    assert standing_intervals(stamps[:1], T[:1]) == []
    assert standing_intervals(stamps[300:500], T[300:500]) == []


def test_drift_of_an_estimate_that_creeps() -> None:
    stamps, T = stop_and_go()
    frames = slice(0, None, 10)
    stamps, T = stamps[frames], T[frames]
    seconds = stamps / SECOND
    creep = np.stack([0.0 * seconds, 0.01 * seconds, 0.0 * seconds], axis=-1)
    turn = np.stack([0.0 * seconds, 0.0 * seconds, 0.001 * seconds], axis=-1)
    estimate = se3.make(T[:, :3, :3] @ so3.exp(turn), T[:, :3, 3] + creep)
    spans = [(0, 3 * SECOND), (7_500_000_000, 10 * SECOND), (20 * SECOND, 30 * SECOND)]
    first, second = standstill_drift(stamps, T, estimate, spans)
    assert (first.start_ns, first.duration_s) == (0, 3.0)
    assert first.translation_m == pytest.approx(0.03, rel=1e-9)
    assert first.speed_mps == pytest.approx(0.01, rel=1e-9)
    assert second.duration_s == pytest.approx(2.5)
    assert second.rotation_rad == pytest.approx(0.0025, rel=1e-9)
