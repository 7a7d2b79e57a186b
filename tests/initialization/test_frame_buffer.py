"""Which frames are kept before the start, and the gyroscope's rotation between them."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.initialization.frame_buffer import FrameBuffer, predicted_rotation
from ovmot.initialization.initializer import FilterInitializer
from ovmot.settings import InitializationSettings, Settings
from ovmot.types import FrontendFrame, ImuNoise, ImuSample
from ovmot.vio.imu_buffer import ImuBuffer

RATE_RPS = np.array([0.0, 0.3, 0.1])
PERIOD_NS = 100_000_000


def frame(stamp: int) -> FrontendFrame:
    none = np.empty(0, dtype=np.int64)
    return FrontendFrame(
        stamp, none, np.empty((0, 4)), np.empty((0, 4)), none, np.empty(0, dtype=np.bool_)
    )


@pytest.fixture
def imu() -> ImuBuffer:
    """Three seconds at 100 Hz from 0.5 s on, turning at a constant rate."""
    buffer = ImuBuffer()
    for k in range(50, 350):
        buffer.append(ImuSample(k * 10_000_000, RATE_RPS, np.array([0.0, 0.0, 9.81])))
    return buffer


@pytest.fixture
def buffer(rig: StereoRig, noise: ImuNoise) -> FrameBuffer:
    settings = Settings(initialization=InitializationSettings(window_s=0.5, motion_window_s=1.0))
    return FrameBuffer(FilterInitializer(rig, noise, settings), settings.initialization)


def test_frames_older_than_the_imu_or_the_window_go(buffer: FrameBuffer, imu: ImuBuffer) -> None:
    for k in range(30):
        buffer.append(frame(k * PERIOD_NS), imu)
        oldest = buffer.frames[0].timestamp_ns
        if k >= 5:
            assert oldest >= 500_000_000
    assert buffer.frames[-1].timestamp_ns == 2_900_000_000
    assert buffer.frames[0].timestamp_ns == 1_700_000_000  # 1.2 times the window
    buffer.clear()
    assert buffer.frames == ()


def test_the_imu_is_needed_for_a_rest_before_the_first_frame(
    buffer: FrameBuffer, imu: ImuBuffer, rig: StereoRig
) -> None:
    buffer.append(frame(2_000_000_000), imu)
    offset_ns = round(1e9 * rig.time_offset_s)
    assert buffer.imu_needed_from_ns == 1_500_000_000 + offset_ns


def test_the_rotation_is_that_of_the_gyroscope_in_the_camera(
    imu: ImuBuffer, rig: StereoRig
) -> None:
    T = predicted_rotation(1_000_000_000, 1_100_000_000, imu, rig)
    R_cam_imu = rig.T_imu_cam0[:3, :3].T
    expected = R_cam_imu @ so3.exp(-0.1 * RATE_RPS) @ R_cam_imu.T
    np.testing.assert_allclose(T[:3, :3], expected, atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], 0.0, atol=0.0)
    unknown = predicted_rotation(8_000_000_000, 9_000_000_000, imu, rig)  # no IMU there
    np.testing.assert_array_equal(unknown, np.eye(4))
