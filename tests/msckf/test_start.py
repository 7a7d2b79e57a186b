"""How the filter starts: at rest if the rig rests, else in motion, else a reason."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.config import Settings
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.imu_buffer import ImuBuffer
from ovmot.msckf.ego import FilterEgo
from ovmot.msckf.start import FilterStart
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample

FRAME_NS = 100_000_000
Observe = Callable[..., FrontendFrame]


def buffer_of(data: ImuData) -> ImuBuffer:
    buffer = ImuBuffer()
    for stamp, gyro, accel in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    return buffer


def imu_stamps(start_ns: int, span_s: float) -> IntArray:
    return start_ns - 600_000_000 + 5_000_000 * np.arange(round(200 * (span_s + 0.7)))


@pytest.fixture
def start(rig: StereoRig, noise: ImuNoise) -> FilterStart:
    return FilterStart(rig, noise, Settings())


@pytest.fixture
def rest_imu(noise: ImuNoise, start_ns: int) -> ImuBuffer:
    """Two seconds of a rig that rests, tilted."""
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
    """Six frames of a resting rig while 40 % of the points move."""
    T, rng = se3.make(so3.exp(np.array([0.1, -0.2, 0.0])), np.zeros(3)), np.random.default_rng(2)
    movers = (np.arange(len(landmarks)) % 10 < 4)[:, None]
    return [
        observe(rig, T, landmarks + movers * [0.0, 0.3 * k, 0.0], start_ns + FRAME_NS * k, 0.1, rng)
        for k in range(6)
    ]


def test_a_resting_rig_starts_at_its_first_frame(
    start: FilterStart, rest_frames: list[FrontendFrame], rest_imu: ImuBuffer, start_ns: int
) -> None:
    ego = start(rest_frames, rest_imu)
    assert isinstance(ego, FilterEgo)
    assert ego.state.timestamp_ns == start_ns
    np.testing.assert_array_equal(ego.state.imu.position, 0.0)
    np.testing.assert_allclose(ego.state.imu.gyro_bias, [0.01, 0.02, -0.01], atol=4e-3)
    assert ego.settings is start.settings
    # the first frame's pose is the start's
    first = ego.predict(start_ns, rest_imu)
    np.testing.assert_array_equal(first.state.clones.timestamp_ns, [start_ns])
    np.testing.assert_array_equal(first.state.clones.T_world_imu[0], first.estimate(0).T_world_imu)


def test_a_driving_rig_starts_in_motion(
    start: FilterStart, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Observe, start_ns: int,
) -> None:  # fmt: skip
    rng = np.random.default_rng(3)
    stamps = [start_ns + FRAME_NS * k for k in range(13)]
    frames = [observe(rig, curvy_path.pose(t), landmarks, t, 0.3, rng) for t in stamps]
    imu = buffer_of(perfect_imu(curvy_path, imu_stamps(start_ns, 1.3)))
    too_short = start(frames[:8], imu)
    assert isinstance(too_short, str)
    assert too_short.startswith("not at rest: ")
    ego = start(frames, imu)
    assert isinstance(ego, FilterEgo)
    assert ego.state.timestamp_ns == start_ns
    speed = float(np.linalg.norm(curvy_path.velocity(start_ns)))
    assert np.linalg.norm(ego.state.imu.velocity) == pytest.approx(speed, abs=0.1)


def test_both_reasons_are_given(
    start: FilterStart, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Observe, start_ns: int,
) -> None:  # fmt: skip
    stamps = [start_ns + FRAME_NS * k for k in range(13)]
    frames = [observe(rig, curvy_path.pose(t), landmarks[:3], t) for t in stamps]
    reason = start(frames, buffer_of(perfect_imu(curvy_path, imu_stamps(start_ns, 1.3))))
    assert isinstance(reason, str)
    assert "not at rest" in reason
    assert "in motion: no common stereo motion among" in reason


def test_too_little_imu_is_a_reason(
    start: FilterStart, rest_frames: list[FrontendFrame], rest_imu: ImuBuffer
) -> None:
    assert "fewer than 3 frames over 0.5 s of IMU" in str(start(rest_frames[:2], rest_imu))
    rest_imu.forget_before(rest_frames[-1].timestamp_ns - 100_000_000)
    assert "fewer than 3 frames over 0.5 s of IMU" in str(start(rest_frames, rest_imu))


def test_a_frame_waits_for_imu_beyond_the_time_offset(rig: StereoRig, noise: ImuNoise) -> None:
    fixed = Settings.model_validate({"filter": {"estimate_time_offset": False}})
    assert FilterStart(rig, noise, fixed).imu_needed_until(1_000) == 1_000
    free = Settings.model_validate({"filter": {"time_offset_sigma_s": 0.002}})
    needed = FilterStart(rig, noise, free).imu_needed_until(1_000)
    assert needed is not None
    assert needed >= 1_000 + 3 * 2_000_000
