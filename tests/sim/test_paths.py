"""The drive stands where it says, follows its road and moves as fast as its profile."""

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.paths import drive_path, standing_path, straight_path, traffic_path
from ovmot.sim.profiles import Road, SmoothSteps

ORIGIN = 1_500_000_000_000_000_000
ROAD = Road(SmoothSteps.make((5.0, 0.0), (15.0, 0.02), (60.0, 0.02)), 60.0)
SPEED = SmoothSteps.make((1.5, 0.0), (3.5, 6.0), (4.5, 6.0), (6.0, 0.0), (7.0, 0.0), (8.0, 2.0))
T_VEHICLE_IMU = se3.make(np.eye(3), np.array([0.0, 0.0, 1.7]))


def at(seconds: np.ndarray | list[float]) -> np.ndarray:
    return ORIGIN + np.round(1e9 * np.asarray(seconds)).astype(np.int64)


def drive(seed: int = 1) -> PoseSpline:
    return drive_path(
        ROAD, SPEED, ORIGIN, 8.0, np.random.default_rng(seed), T_vehicle_body=T_VEHICLE_IMU
    )


def test_drive_stands_then_moves_then_stands_again() -> None:
    path = drive()
    for begin, end in ((-0.9, 1.2), (6.35, 6.7)):
        still = at(np.linspace(begin, end, 50))
        assert np.abs(path.velocity(still)).max() < 1e-3
        assert np.abs(path.acceleration(still)).max() < 2e-2
        assert np.abs(path.angular_velocity(still)).max() < 1e-3
    speed = np.linalg.norm(path.velocity(at([4.0])), axis=-1)
    np.testing.assert_allclose(speed, 6.0, atol=0.15)


def test_drive_follows_the_road_with_slight_pitch_and_roll() -> None:
    path = drive()
    times = np.linspace(0.0, 8.0, 200)
    T = path.pose(at(times))
    xy, yaw = ROAD.at(SPEED.integral(times))
    np.testing.assert_allclose(T[:, :2, 3], xy, atol=0.06)  # the body leans over its wheels
    np.testing.assert_allclose(np.arctan2(T[:, 1, 0], T[:, 0, 0]), yaw, atol=2e-3)
    tilt = np.degrees(np.arccos(T[:, 2, 2]))
    assert 0.1 < tilt.max() < 2.0


def test_vibration_comes_from_the_generator() -> None:
    times = at([3.0, 4.0])
    np.testing.assert_array_equal(drive(1).pose(times), drive(1).pose(times))
    assert np.abs(drive(1).pose(times) - drive(2).pose(times)).max() > 1e-4


def test_oncoming_traffic_faces_and_moves_the_other_way() -> None:
    speed = SmoothSteps.make((0.0, 5.0))
    path = traffic_path(ROAD, speed, ORIGIN, 4.0, start_m=50.0, offset_m=1.7, oncoming=True)
    T = path.pose(at([2.0]))[0]
    xy, yaw = ROAD.at(np.array(40.0), 1.7)
    np.testing.assert_allclose(T[:2, 3], xy, atol=1e-5)
    np.testing.assert_allclose(T[:2, 0], [-np.cos(yaw), -np.sin(yaw)], atol=1e-5)
    velocity = path.velocity(at([2.0]))[0]
    np.testing.assert_allclose(velocity / np.linalg.norm(velocity), T[:3, 0], atol=1e-4)


def test_straight_path_and_standing_path() -> None:
    walk = straight_path((1.0, 2.0), np.pi / 2, SmoothSteps.make((0.0, 1.5)), ORIGIN, 3.0)
    np.testing.assert_allclose(walk.pose(at([2.0]))[0, :3, 3], [1.0, 5.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(walk.velocity(at([2.0]))[0], [0.0, 1.5, 0.0], atol=1e-9)
    rest = standing_path(T_VEHICLE_IMU, ORIGIN, 3.0)
    np.testing.assert_allclose(rest.pose(at([-1.0, 4.0])), [T_VEHICLE_IMU] * 2, atol=1e-12)
