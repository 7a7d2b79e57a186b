"""A random drive stops, turns at right angles, and stays within what tyres and people bear."""

import numpy as np

from ovmot.sim.paths import drive_path
from ovmot.sim.rides import city_drive

ORIGIN = 1_500_000_000_000_000_000


def test_stops_turns_and_comfort() -> None:
    rng = np.random.default_rng(3)
    road, speed = city_drive(120.0, rng)
    path = drive_path(road, speed, ORIGIN, 120.0, rng, T_vehicle_body=np.eye(4))
    times = ORIGIN + np.round(np.linspace(0.0, 120e9, 6000)).astype(np.int64)
    pace = np.linalg.norm(path.velocity(times)[:, :2], axis=-1)
    standing = pace < 0.01
    assert standing[: int(1.4 * 50)].all()
    assert np.count_nonzero(np.diff(standing.astype(int)) == 1) >= 2  # stops after the start
    assert 8.0 < pace.max() < 12.5
    horizontal = np.linalg.norm(path.acceleration(times)[:, :2], axis=-1)
    assert 2.0 < horizontal.max() < 6.5
    T = path.pose(times)
    yaw = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    quarter = np.round(yaw[standing] / (0.5 * np.pi))
    np.testing.assert_allclose(yaw[standing], 0.5 * np.pi * quarter, atol=0.01)
    assert len(np.unique(quarter)) > 1


def test_without_stops_it_keeps_moving() -> None:
    _, speed = city_drive(60.0, np.random.default_rng(0), stop_share=0.0)
    assert speed(np.linspace(6.0, 60.0, 500)).min() >= 4.0
