"""The filter's initializer: static, else dynamic, else a reason."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.initializer import FilterInitializer
from ovmot.settings import Settings
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import ACCEL_BIAS, GYRO_BIAS, THETA, VELOCITY, ImuState

FRAME_NS = 100_000_000
Observe = Callable[..., FrontendFrame]
StartError = Callable[[ImuState, ImuState], FloatArray]


def buffer_of(data: ImuData) -> ImuBuffer:
    buffer = ImuBuffer()
    for stamp, gyro, accel in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    return buffer


def imu_stamps(start_ns: int, span_s: float) -> IntArray:
    return start_ns - 600_000_000 + 5_000_000 * np.arange(round(200 * (span_s + 0.7)))


@pytest.fixture
def initializer(rig: StereoRig, noise: ImuNoise) -> FilterInitializer:
    return FilterInitializer(rig, noise, Settings())


@pytest.fixture
def rest_imu(noise: ImuNoise, start_ns: int) -> ImuBuffer:
    """Two seconds of a stationary, tilted rig."""
    t = imu_stamps(start_ns, 2.0)
    one, up = np.ones((len(t), 1)), so3.exp(np.array([0.1, -0.2, 0.0])).T @ [0.0, 0.0, 9.81]
    clean = ImuData(t, one * np.zeros(3), one * up)
    bias = np.array([0.01, 0.02, -0.01])
    rng = np.random.default_rng(1)
    return buffer_of(noisy_imu(clean, noise, rng, gyro_bias=bias, accel_bias=0.0 * bias).data)


@pytest.fixture
def rest_frames(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, start_ns: int
) -> list[FrontendFrame]:
    """Six frames of a stationary rig while 40 % of the points move."""
    T, rng = se3.make(so3.exp(np.array([0.1, -0.2, 0.0])), np.zeros(3)), np.random.default_rng(2)
    movers = (np.arange(len(landmarks)) % 10 < 4)[:, None]
    return [
        observe(rig, T, landmarks + movers * [0.0, 0.3 * k, 0.0], start_ns + FRAME_NS * k, 0.1, rng)
        for k in range(6)
    ]


def initialized(found: tuple[MsckfFilter, FeatureTable] | str) -> tuple[MsckfFilter, FeatureTable]:
    assert not isinstance(found, str), found
    return found


def test_a_stationary_rig_is_initialized_at_its_last_frame(
    initializer: FilterInitializer, rest_frames: list[FrontendFrame], rest_imu: ImuBuffer
) -> None:
    ego, table = initialized(initializer(rest_frames, rest_imu))
    state = ego.state
    assert ego.stationary
    assert ego.settings is initializer.settings
    assert state.timestamp_ns == rest_frames[-1].timestamp_ns
    assert np.linalg.norm(state.imu.position) < 2e-3
    np.testing.assert_allclose(state.imu.gyro_bias, [0.01, 0.02, -0.01], atol=4e-3)
    stamps = [f.timestamp_ns for f in rest_frames]
    np.testing.assert_array_equal(state.clones.timestamp_ns, stamps)
    np.testing.assert_array_equal(table.frame_ns, stamps)
    assert not table.used.any()  # images of a stationary rig are left to the filter


def test_errors_of_static_initialization_are_as_large_as_claimed(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, noise: ImuNoise, start_ns: int,
    start_error: StartError,
) -> None:  # fmt: skip
    """Tilt is tied to the accelerometer bias: alone, either is known far worse than the two."""
    quiet = replace(noise, accel=5e-3)
    initializer = FilterInitializer(rig, quiet, Settings())
    rng, n_trials, tied, gyro = np.random.default_rng(4), 60, [], []
    columns = np.r_[0:3, 12:15]
    t, zero = imu_stamps(start_ns, 0.6), np.zeros(3)
    one = np.ones((len(t), 1))
    for _ in range(n_trials):
        R = so3.exp(rng.uniform(-1.0, 1.0, 3) * [0.2, 0.2, 3.0])
        T = se3.make(R, zero)
        clean = ImuData(t, one * zero, one * (R.T @ [0.0, 0.0, 9.81]))
        sensor = noisy_imu(
            clean, quiet, rng, gyro_bias=rng.normal(0.0, 0.05, 3),
            accel_bias=rng.normal(0.0, 0.05, 3),
        )  # fmt: skip
        points = se3.apply(T, landmarks[:60])
        frames = [observe(rig, T, points, start_ns + FRAME_NS * k, 0.1, rng) for k in range(6)]
        ego, _ = initialized(initializer(frames, buffer_of(sensor.data)))
        at = int(np.searchsorted(t, ego.state.timestamp_ns))
        truth = ImuState(R, zero, zero, sensor.gyro_bias[at], sensor.accel_bias[at])
        e, P = start_error(truth, ego.state.imu), ego.state.covariance
        tied.append(e[columns] @ np.linalg.solve(P[np.ix_(columns, columns)], e[columns]))
        gyro.append(e[GYRO_BIAS] @ np.linalg.solve(P[GYRO_BIAS, GYRO_BIAS], e[GYRO_BIAS]))
    # two tilts and three biases: heading is no error. The covariance has room for a body that rocks
    # on its springs, which this one does not.
    for nees, dof in ((tied, 5), (gyro, 3)):
        low, high = np.asarray(chi2.ppf([0.025, 0.975], dof * n_trials)) / n_trials
        assert 0.6 * low < np.mean(nees) < high
    up = R.T @ np.array([0.0, 0.0, 1.0])
    side = np.cross(up, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(up, [1.0, 0.0, 0.0]))
    cross, bias = P[THETA, ACCEL_BIAS], P[ACCEL_BIAS, ACCEL_BIAS]
    tilt = side @ P[THETA, THETA] @ side
    assert np.sqrt(tilt) == pytest.approx(0.05 / 9.81, rel=0.05)
    assert side @ (P[THETA, THETA] - cross @ np.linalg.solve(bias, cross.T)) @ side < 0.1 * tilt


Drive = Callable[..., tuple[list[FrontendFrame], ImuBuffer]]


@pytest.fixture
def drive(
    rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray, observe: Observe,
    noise: ImuNoise, start_ns: int,
) -> Drive:  # fmt: skip
    """From a seed and the way (3,) of a truck after t seconds: frames of 1.2 s, and the IMU."""

    def make(
        seed: int, truck_way: Callable[[float], FloatArray] | None = None
    ) -> tuple[list[FrontendFrame], ImuBuffer]:
        rng = np.random.default_rng(seed)
        truck = rng.uniform([9.0, -2.0, -1.0], [12.0, 1.5, 2.0], (300, 3))
        frames = []
        for k in range(13):
            t = start_ns + FRAME_NS * k
            points = landmarks
            if truck_way is not None:
                points = np.concatenate([landmarks[:150], truck + truck_way(0.1 * k)])
            frames.append(observe(rig, curvy_path.pose(t), points, t, 0.7, rng))
        data = noisy_imu(
            perfect_imu(curvy_path, imu_stamps(start_ns, 1.3)), noise, rng,
            gyro_bias=rng.normal(0.0, 0.02, 3), accel_bias=rng.normal(0.0, 0.05, 3),
        )  # fmt: skip
        return frames, buffer_of(data.data)

    return make


def test_a_moving_rig_is_initialized_at_its_last_frame(
    initializer: FilterInitializer, drive: Drive, curvy_path: PoseSpline
) -> None:
    frames, imu = drive(3)
    too_short = initializer(frames[:8], imu)
    assert isinstance(too_short, str)
    assert too_short.startswith("static initialization: ")
    assert "dynamic initialization: 0.70 s of frames (needs 1.2 s)" in too_short
    ego, table = initialized(initializer(frames, imu))
    assert not ego.stationary
    last_ns = frames[-1].timestamp_ns
    assert ego.state.timestamp_ns == last_ns
    speed = float(np.linalg.norm(curvy_path.velocity(last_ns)))
    assert np.linalg.norm(ego.state.imu.velocity) == pytest.approx(speed, abs=0.05)
    # the path is that driven
    T, true = ego.state.clones.T_world_imu, curvy_path.pose(ego.state.clones.timestamp_ns)
    between, expected = se3.inverse(T[0]) @ T, se3.inverse(true[0]) @ true
    assert np.abs(between[:, :3, 3] - expected[:, :3, 3]).max() < 0.04
    assert np.linalg.eigvalsh(ego.state.covariance).min() > -1e-12
    np.testing.assert_array_equal(table.frame_ns, ego.state.clones.timestamp_ns)


def test_nothing_is_used_twice_and_slam_candidates_are_left(
    initializer: FilterInitializer, drive: Drive
) -> None:
    frames, imu = drive(4)
    _, table = initialized(initializer(frames, imu))
    used = table.used.any(axis=0)
    np.testing.assert_array_equal(table.used[:, used], table.seen[:, used])
    whole = table.seen.sum(axis=0) > 1
    assert used.sum() > 30
    assert (table.seen_now & whole & ~used).sum() == initializer.settings.filter.max_landmarks


TRUCKS: dict[str, Callable[[float], FloatArray]] = {
    "swerving": lambda t: np.array([2.5 * t, 1.2 * np.sin(5.0 * t), 0.0]),
    "steady": lambda t: np.array([4.0 * t, -0.5 * t, 0.0]),
}


@pytest.mark.parametrize("truck", list(TRUCKS))
def test_behind_a_truck_that_fills_the_view_it_moves_against_the_world(
    truck: str, initializer: FilterInitializer, drive: Drive, curvy_path: PoseSpline
) -> None:
    frames, imu = drive(5, TRUCKS[truck])
    ego, _ = initialized(initializer(frames, imu))
    T, true = ego.state.clones.T_world_imu, curvy_path.pose(ego.state.clones.timestamp_ns)
    between, expected = se3.inverse(T[0]) @ T, se3.inverse(true[0]) @ true
    assert np.abs(between[:, :3, 3] - expected[:, :3, 3]).max() < 0.1
    speed = float(np.linalg.norm(curvy_path.velocity(frames[-1].timestamp_ns)))
    assert np.linalg.norm(ego.state.imu.velocity) == pytest.approx(speed, abs=0.15)


def test_errors_of_dynamic_initialization_are_as_large_as_claimed(
    initializer: FilterInitializer, drive: Drive, curvy_path: PoseSpline, start_error: StartError
) -> None:
    """Tilt and velocity of the last frame: what does not depend on where the world begins."""
    n_trials, nees = 10, []
    for seed in range(n_trials):
        frames, imu = drive(seed)
        ego, _ = initialized(initializer(frames, imu))
        last_ns = frames[-1].timestamp_ns
        T, v, state = curvy_path.pose(last_ns), curvy_path.velocity(last_ns), ego.state.imu
        tilt = T[2, :3] @ state.R_world_imu.T  # where up stands: error in x and y
        e = np.array([tilt[1], -tilt[0], *(T[:3, :3].T @ v - state.R_world_imu.T @ state.velocity)])
        P, R = ego.state.covariance, state.R_world_imu
        G = np.zeros((5, len(P)))
        G[:2, THETA], G[2:, THETA], G[2:, VELOCITY] = R[:2], so3.hat(R.T @ state.velocity), R.T
        nees.append(e @ np.linalg.solve(G @ P @ G.T, e))
    low, high = np.asarray(chi2.ppf([0.025, 0.975], 5 * n_trials)) / n_trials
    assert low < np.mean(nees) < high


def test_both_reasons_are_given(
    initializer: FilterInitializer, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Observe, start_ns: int,
) -> None:  # fmt: skip
    stamps = [start_ns + FRAME_NS * k for k in range(13)]
    frames = [observe(rig, curvy_path.pose(t), landmarks[:3], t) for t in stamps]
    reason = initializer(frames, buffer_of(perfect_imu(curvy_path, imu_stamps(start_ns, 1.3))))
    assert isinstance(reason, str)
    assert "static initialization: " in reason
    assert "dynamic initialization: no common stereo motion among" in reason


def test_too_little_imu_is_a_reason(
    initializer: FilterInitializer, rest_frames: list[FrontendFrame], rest_imu: ImuBuffer
) -> None:
    assert "fewer than 3 frames over 0.5 s of IMU" in str(initializer(rest_frames[:2], rest_imu))
    rest_imu.drop_before(rest_frames[-1].timestamp_ns - 100_000_000)
    assert "fewer than 3 frames over 0.5 s of IMU" in str(initializer(rest_frames, rest_imu))
