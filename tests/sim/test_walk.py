"""A hand-held walk steps, sways and pauses as a person does."""

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.sim.paths import MARGIN_S
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.walk import STEP_HZ, WALKING_MPS, stroll, walk_path

ORIGIN = 1_500_000_000_000_000_000
T_WALKER_IMU = se3.make(np.eye(3), np.array([0.3, 0.0, 1.4]))


def every(step_s: float, first: float, last: float) -> np.ndarray:
    return ORIGIN + np.round(1e9 * np.arange(first, last, step_s)).astype(np.int64)


def test_steps_have_the_frequency_and_the_force_of_walking() -> None:
    straight = Road(SmoothSteps.make((0.0, 0.0)), 100.0)
    pace = SmoothSteps.make((0.0, WALKING_MPS))
    rng = np.random.default_rng(0)
    path = walk_path(straight, pace, ORIGIN, 20.0, rng, T_walker_body=T_WALKER_IMU)
    times = every(0.02, 0.0, 20.0)
    z = path.pose(times)[:, 2, 3]
    assert np.abs(z - 1.4).max() < 0.06
    power = np.abs(np.fft.rfft(z - z.mean()))
    strongest = np.fft.rfftfreq(len(z), 0.02)[np.argmax(power)]
    assert strongest == pytest.approx(STEP_HZ, abs=0.06)
    speed = np.linalg.norm(path.velocity(times).mean(axis=0))
    assert speed == pytest.approx(WALKING_MPS, rel=0.02)
    assert 1.0 < path.acceleration(times)[:, 2].std() < 3.0
    rates = np.linalg.norm(path.angular_velocity(times), axis=-1)
    assert 0.05 < rates.mean() < 0.6


def test_a_stroll_stands_walks_turns_and_pauses() -> None:
    rng = np.random.default_rng(2)
    road, speed = stroll(60.0, rng, pause_share=0.5)
    path = walk_path(road, speed, ORIGIN, 60.0, rng, T_walker_body=T_WALKER_IMU)
    standing = np.linalg.norm(path.velocity(every(0.05, -MARGIN_S, 1.3)), axis=-1)
    assert 0.0 < standing.max() < 0.2  # hands tremble
    times = every(0.1, 0.0, 60.0)
    slow = speed(1e-9 * (times - ORIGIN)) < 1e-9
    assert 0.05 < slow.mean() < 0.5
    yaw = np.unwrap(np.arctan2(path.pose(times)[:, 1, 0], path.pose(times)[:, 0, 0]))
    assert np.ptp(yaw) > 1.0
    assert np.linalg.norm(path.acceleration(times), axis=-1).max() < 8.0
    assert np.linalg.norm(path.angular_velocity(times), axis=-1).max() < 2.5


def test_the_walk_comes_from_its_generator() -> None:
    def pose(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        path = walk_path(*stroll(10.0, rng), ORIGIN, 10.0, rng, T_walker_body=T_WALKER_IMU)
        return path.pose(ORIGIN + 8 * 10**9)

    np.testing.assert_array_equal(pose(1), pose(1))
    assert np.abs(pose(1) - pose(2)).max() > 1e-3
