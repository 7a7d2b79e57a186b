"""The spline's laws: it meets its poses, and its derivatives are those of finite differences."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.splines import PoseSpline


def wild_poses(count: int = 30, spread: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Poses at uneven times that turn by some 0.2 rad a knot, on all axes."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.integers(int(0.06e9), int(0.14e9), count)) + 1_500_000_000_000_000_000
    R = np.empty((count, 3, 3))
    R[0] = np.eye(3)
    for i in range(1, count):
        R[i] = R[i - 1] @ so3.exp(rng.normal(0.0, spread, 3))
    positions = np.cumsum(rng.normal(0.2, 0.3, (count, 3)), axis=0)
    return times, se3.make(R, positions)


@pytest.fixture(params=[3, 4, 5])
def spline(request: pytest.FixtureRequest) -> PoseSpline:
    return PoseSpline.through(*wild_poses(), degree=request.param)


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_meets_its_poses(degree: int) -> None:
    times, poses = wild_poses()
    spline = PoseSpline.through(times, poses, degree)
    np.testing.assert_allclose(spline.pose(times), poses, atol=1e-9)


def test_rotations_stay_rotations_between_poses(spline: PoseSpline) -> None:
    times = np.linspace(0, spline.end_ns - spline.start_ns, 501).astype(np.int64) + spline.start_ns
    R = spline.pose(times)[:, :3, :3]
    identity = np.broadcast_to(np.eye(3), R.shape)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), identity, atol=1e-12)


def test_derivatives_match_finite_differences(spline: PoseSpline) -> None:
    rng = np.random.default_rng(0)
    h = 20_000
    times = rng.integers(spline.start_ns + h, spline.end_ns - h, 200)
    before, after = spline.pose(times - h), spline.pose(times + h)
    dt = 2e-9 * h
    np.testing.assert_allclose(
        spline.velocity(times), (after[:, :3, 3] - before[:, :3, 3]) / dt, atol=2e-5
    )
    turned = so3.log(np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]) / dt
    np.testing.assert_allclose(spline.angular_velocity(times), turned, atol=2e-4)
    np.testing.assert_allclose(
        spline.acceleration(times),
        (spline.velocity(times + h) - spline.velocity(times - h)) / dt,
        atol=2e-2,
    )
    np.testing.assert_allclose(
        spline.angular_acceleration(times),
        (spline.angular_velocity(times + h) - spline.angular_velocity(times - h)) / dt,
        atol=2e-2,
    )


def test_derivatives_do_not_jump_at_poses(spline: PoseSpline) -> None:
    times = wild_poses()[0][1:-1]
    for quantity in (
        spline.velocity,
        spline.acceleration,
        spline.angular_velocity,
        spline.angular_acceleration,
    ):
        jump = np.abs(quantity(times + 1) - quantity(times - 1)).max()
        assert jump < 1e-3, quantity.__name__


def test_constant_turn_is_exact() -> None:
    times = np.arange(12) * 100_000_000
    seconds = 1e-9 * times
    rate = np.array([0.1, -0.4, 0.8])
    spline = PoseSpline.through(
        times, se3.make(so3.exp(seconds[:, None] * rate), seconds[:, None] * [1.0, 2.0, 3.0])
    )
    inner = np.array([0, 123_456_789, 1_100_000_000])
    np.testing.assert_allclose(spline.angular_velocity(inner), np.tile(rate, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(spline.angular_acceleration(inner), 0.0, atol=1e-7)
    np.testing.assert_allclose(spline.acceleration(inner), 0.0, atol=1e-9)


def test_shapes_follow_the_times() -> None:
    spline = PoseSpline.through(*wild_poses())
    grid = np.full((2, 3), spline.start_ns, dtype=np.int64)
    assert spline.pose(spline.start_ns).shape == (4, 4)
    assert spline.pose(grid).shape == (2, 3, 4, 4)
    assert spline.angular_velocity(grid).shape == (2, 3, 3)


def test_refuses_what_it_can_not_do() -> None:
    times, poses = wild_poses()
    spline = PoseSpline.through(times, poses)
    with pytest.raises(ValueError, match="outside"):
        spline.pose(spline.end_ns + 1)
    with pytest.raises(ValueError, match="more than 5"):
        PoseSpline.through(times[:5], poses[:5])
    with pytest.raises(ValueError, match="rise"):
        PoseSpline.through(times[::-1], poses)
