"""The time offset of a start in motion: found where the rig turns unevenly, else as calibrated."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.clock_offset import ClockOffset, find_clock_offset
from ovmot.initialization.stereo_path import StereoPath
from ovmot.types import ImuSample
from ovmot.vio.imu_buffer import ImuBuffer

ROTATION_SIGMA = 3e-4
KNOWN = ClockOffset(0.01, 0.005)
ORIGIN_NS = 5_000_000_000


def turned(t: FloatArray, amplitude: float) -> FloatArray:
    """Angle (N,) about the vertical at times (N,), radians."""
    return np.asarray(amplitude * np.sin(3.0 * t))


def window(offset_s: float, amplitude: float) -> tuple[StereoPath, IntArray, ImuBuffer]:
    """A path of 13 frames, 0.1 s apart, their times by the known offset, and the IMU around them.

    The pictures' clock is off by `offset_s` in truth, the gyroscope has a bias.
    """
    rng = np.random.default_rng(4)
    imu = ImuBuffer()
    for t in np.arange(-0.4, 1.8, 0.005):
        rate = 3.0 * amplitude * np.cos(3.0 * t)
        gyro = np.array([0.01, -0.02, 0.015 + rate])
        imu.append(ImuSample(ORIGIN_NS + round(1e9 * t), gyro, np.array([0.0, 0.0, 9.81])))
    stamps: FloatArray = 0.1 * np.arange(13.0)
    angles = turned(stamps + offset_s, amplitude)
    axis = np.stack([0.0 * angles, 0.0 * angles, angles - angles[0]], axis=1)
    R = so3.exp(axis)
    for k in range(1, len(R)):
        R[k:] = R[k:] @ so3.exp(ROTATION_SIGMA * rng.standard_normal(3))
    sigma = ROTATION_SIGMA * np.sqrt(np.arange(13.0))
    path = StereoPath(se3.make(R, np.zeros((13, 3))), sigma, sigma, np.arange(5))
    imu_ns = ORIGIN_NS + np.round(1e9 * (stamps + KNOWN.value_s)).astype(np.int64)
    return path, imu_ns, imu


@pytest.mark.parametrize("offset_s", [-0.06, 0.06, 0.1])
def test_a_late_camera_is_found_out(offset_s: float) -> None:
    found = find_clock_offset(*window(offset_s, 0.1), KNOWN)
    assert abs(found.value_s - offset_s) < 4.0 * found.sigma_s
    assert found.sigma_s < 0.004


def test_what_agrees_with_the_calibration_leaves_it_as_it_is() -> None:
    assert find_clock_offset(*window(KNOWN.value_s + 0.004, 0.1), KNOWN) == KNOWN


def test_a_rig_that_hardly_turns_shows_no_offset() -> None:
    assert find_clock_offset(*window(0.06, 1e-4), KNOWN) == KNOWN


def test_without_enough_of_the_imu_the_calibration_stays() -> None:
    path, imu_ns, imu = window(0.06, 0.1)
    assert find_clock_offset(path, imu_ns + 500_000_000, imu, KNOWN) == KNOWN
