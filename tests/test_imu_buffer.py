"""Cuts of the IMU stream, with stamps that a double can not hold."""

import numpy as np
import pytest

from ovmot.errors import DatasetError
from ovmot.imu_buffer import ImuBuffer
from ovmot.types import ImuSample

START_NS = 1_500_000_000_123_456_789  # doubles are 256 ns apart here
STEP_NS = 5_000_001


def sample(stamp: int) -> ImuSample:
    """Rates that are linear in time: component i reads i + (i + 1)·seconds."""
    t = (stamp - START_NS) * 1e-9
    i = np.arange(6)
    rates = i + (i + 1) * t
    return ImuSample(stamp, rates[:3], rates[3:])


def filled(n: int = 21) -> ImuBuffer:
    buffer = ImuBuffer()
    for k in range(n):
        buffer.append(sample(START_NS + k * STEP_NS))
    return buffer


@pytest.mark.parametrize(
    ("from_ns", "to_ns", "n"),
    [
        (0, 20 * STEP_NS, 21),  # everything
        (2 * STEP_NS, 3 * STEP_NS, 2),  # on samples
        (2 * STEP_NS + 1, 3 * STEP_NS - 1, 2),  # within one pair
        (STEP_NS + 1_234_567, 7 * STEP_NS + 100, 8),
        (100, 101, 2),  # a nanosecond
    ],
)
def test_cut_is_interpolated_at_both_ends(from_ns: int, to_ns: int, n: int) -> None:
    data = filled().between(START_NS + from_ns, START_NS + to_ns)
    assert len(data) == n
    assert data.timestamp_ns[0] == START_NS + from_ns
    assert data.timestamp_ns[-1] == START_NS + to_ns
    assert (np.diff(data.timestamp_ns) > 0).all()
    expected = [sample(int(stamp)) for stamp in data.timestamp_ns]
    np.testing.assert_allclose(data.gyro, [s.gyro for s in expected], atol=1e-12)
    np.testing.assert_allclose(data.accel, [s.accel for s in expected], atol=1e-12)


def test_neighbouring_cuts_share_their_end() -> None:
    buffer, middle = filled(), START_NS + 33_333_333
    first, second = buffer.between(START_NS, middle), buffer.between(middle, middle + 10_000_000)
    np.testing.assert_array_equal(first.gyro[-1], second.gyro[0])
    assert first.timestamp_ns[-1] == second.timestamp_ns[0] == middle


@pytest.mark.parametrize(
    ("from_ns", "to_ns"), [(-1, STEP_NS), (0, 20 * STEP_NS + 1), (STEP_NS, STEP_NS), (9, 5)]
)
def test_cut_beyond_the_samples_is_an_error(from_ns: int, to_ns: int) -> None:
    with pytest.raises(DatasetError, match=f"does not cover {START_NS + from_ns}"):
        filled().between(START_NS + from_ns, START_NS + to_ns)


def test_cut_of_an_empty_buffer_is_an_error() -> None:
    buffer = ImuBuffer()
    assert buffer.first_ns is None
    assert buffer.last_ns is None
    with pytest.raises(DatasetError, match="does not cover"):
        buffer.between(START_NS, START_NS + 1)


@pytest.mark.parametrize("late_ns", [0, -STEP_NS])
def test_stamps_must_rise(late_ns: int) -> None:
    buffer = filled(3)
    last = START_NS + 2 * STEP_NS
    assert buffer.last_ns == last
    with pytest.raises(DatasetError, match="time order"):
        buffer.append(sample(last + late_ns))
    assert len(buffer) == 3


@pytest.mark.parametrize(
    ("at_ns", "oldest"),
    [(5 * STEP_NS, 4), (5 * STEP_NS + 1, 5), (0, 0), (-99, 0), (99 * STEP_NS, 20)],
)
def test_forgetting_keeps_what_a_cut_can_need(at_ns: int, oldest: int) -> None:
    buffer = filled()
    full = filled()
    buffer.forget_before(START_NS + at_ns)
    assert buffer.first_ns == START_NS + oldest * STEP_NS
    begin = max(START_NS + at_ns, START_NS)
    if begin < START_NS + 20 * STEP_NS:
        kept = buffer.between(begin, START_NS + 20 * STEP_NS)
        np.testing.assert_array_equal(kept.gyro, full.between(begin, START_NS + 20 * STEP_NS).gyro)
