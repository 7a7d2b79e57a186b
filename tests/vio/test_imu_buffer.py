"""Intervals of the IMU stream between exact times."""

import numpy as np
import pytest

from ovmot.errors import DatasetError
from ovmot.types import ImuSample
from ovmot.vio.imu_buffer import ImuBuffer

EPOCH = 1_403_636_580_000_000_003


def buffer_of(n: int = 11, period_ns: int = 10_000_000) -> ImuBuffer:
    """Rates that grow by time: gyro x is the seconds since EPOCH, accel z twice that."""
    buffer = ImuBuffer()
    for i in range(n):
        t = 1e-9 * period_ns * i
        gyro, accel = np.array([t, 0.0, 1.0]), np.array([0.0, -1.0, 2.0 * t])
        buffer.append(ImuSample(EPOCH + period_ns * i, gyro, accel))
    return buffer


def test_both_ends_of_an_interval_are_interpolated() -> None:
    interval = buffer_of().between(EPOCH + 12_500_000, EPOCH + 37_000_001)
    assert (interval.timestamp_ns - EPOCH).tolist() == [
        12_500_000,
        20_000_000,
        30_000_000,
        37_000_001,
    ]
    seconds = 1e-9 * (interval.timestamp_ns - EPOCH)
    np.testing.assert_allclose(interval.gyro[:, 0], seconds, atol=1e-12)
    np.testing.assert_allclose(interval.accel[:, 2], 2.0 * seconds, atol=1e-12)
    np.testing.assert_allclose(interval.gyro[:, 2], 1.0)


def test_an_interval_between_samples_takes_them_once() -> None:
    interval = buffer_of().between(EPOCH + 20_000_000, EPOCH + 40_000_000)
    assert (interval.timestamp_ns - EPOCH).tolist() == [20_000_000, 30_000_000, 40_000_000]


def test_an_interval_within_two_samples() -> None:
    interval = buffer_of().between(EPOCH + 21_000_000, EPOCH + 22_000_000)
    np.testing.assert_allclose(interval.gyro[:, 0], [0.021, 0.022], atol=1e-12)


@pytest.mark.parametrize(("start", "end"), [(-1, 5), (5, 100_000_001), (7, 7), (9, 8)])
def test_what_is_not_covered_is_an_error(start: int, end: int) -> None:
    with pytest.raises(DatasetError, match="does not cover"):
        buffer_of().between(EPOCH + start, EPOCH + end)
    with pytest.raises(DatasetError, match="does not cover"):
        ImuBuffer().between(0, 1)


@pytest.mark.parametrize("step", [0, -10])
def test_stamps_must_rise(step: int) -> None:
    buffer = buffer_of(3)
    zero = np.zeros(3)
    with pytest.raises(DatasetError, match="does not follow"):
        buffer.append(ImuSample(EPOCH + 20_000_000 + step, zero, zero))
    assert len(buffer) == 3


def test_dropping_keeps_what_a_later_interval_needs() -> None:
    buffer = buffer_of()
    buffer.drop_before(EPOCH + 45_000_000)
    assert buffer.first_ns == EPOCH + 40_000_000
    assert buffer.last_ns == EPOCH + 100_000_000
    assert len(buffer.between(EPOCH + 45_000_000, EPOCH + 60_000_000)) == 3
    buffer.drop_before(EPOCH)
    assert buffer.first_ns == EPOCH + 40_000_000


def test_one_reading_is_interpolated_also_at_both_ends_of_the_buffer() -> None:
    buffer = buffer_of()
    for offset_ns in (0, 12_500_000, 20_000_000, 100_000_000):
        reading = buffer.at(EPOCH + offset_ns)
        assert reading.timestamp_ns == EPOCH + offset_ns
        np.testing.assert_allclose(reading.gyro, [1e-9 * offset_ns, 0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(reading.accel, [0.0, -1.0, 2e-9 * offset_ns], atol=1e-12)


def test_a_reading_outside_the_buffer_is_refused() -> None:
    for outside in (EPOCH - 1, EPOCH + 100_000_001):
        with pytest.raises(DatasetError, match="does not cover"):
            buffer_of().at(outside)
