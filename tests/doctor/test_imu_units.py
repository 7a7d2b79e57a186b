"""Units, gravity and range of the IMU's values."""

import numpy as np
import pytest

from ovmot.doctor.imu_units import (
    at_range_end,
    check_accel_unit,
    check_gravity,
    check_gyro_range,
    check_imu_saturation,
)
from ovmot.doctor.report import Severity
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.rigs import R_AHEAD
from ovmot.types import ImuData


def drive(gravity: float = 9.81) -> ImuData:
    """Twenty seconds at 100 Hz: two at rest, then braking and turning."""
    rng = np.random.default_rng(4)
    ns = 10_000_000 * np.arange(2000, dtype=np.int64)
    moves = (np.arange(2000) > 200)[:, None]
    accel = rng.normal(0.0, 0.02, (2000, 3)) + moves * rng.normal(0.0, 1.0, (2000, 3))
    gyro = rng.normal(0.0, 0.002, (2000, 3)) + moves * rng.normal(0.0, 0.3, (2000, 3))
    return ImuData(ns, gyro, accel + np.array([0.1, 0.0, gravity]))


def scaled(imu: ImuData, gyro: float = 1.0, accel: float = 1.0) -> ImuData:
    return ImuData(imu.timestamp_ns, imu.gyro * gyro, imu.accel * accel)


@pytest.mark.parametrize(
    ("factor", "severity", "remedy"),
    [
        (1.0, Severity.FINE, ""),
        (1.0 / 9.80665, Severity.WRONG, "unit is g"),
        (1000.0 / 9.80665, Severity.WRONG, "unit is mg"),
        (1.1, Severity.DOUBTFUL, "scale"),
        (3.28, Severity.WRONG, "convert"),
    ],
)
def test_accel_unit(factor: float, severity: Severity, remedy: str) -> None:
    found = check_accel_unit(scaled(drive(), accel=factor))
    assert found.severity is severity
    assert remedy in found.remedy


def test_gravity_taken_off() -> None:
    found = check_accel_unit(drive(gravity=0.0))
    assert found.severity is Severity.WRONG
    assert "gravity has been taken off" in found.remedy


def test_gyro_range() -> None:
    assert check_gyro_range(drive()).severity is Severity.FINE
    assert check_gyro_range(scaled(drive(), gyro=57.3)).severity is Severity.WRONG


@pytest.mark.parametrize(
    ("turn", "severity", "says"),
    [
        ([0.0, 0.0, 0.0], Severity.FINE, "rolled 0°"),
        ([-np.pi / 2.0, 0.0, 0.0], Severity.DOUBTFUL, "89° down"),
        ([0.0, 0.0, np.pi], Severity.DOUBTFUL, "rolled 180°"),
    ],
)
def test_gravity_direction(turn: list[float], severity: Severity, says: str) -> None:
    R: FloatArray = R_AHEAD @ so3.exp(np.array(turn))
    found = check_gravity(drive(), R, "the mount")
    assert found.severity is severity
    assert says in found.says


def test_a_clipped_axis_is_at_the_range_end() -> None:
    imu = drive()
    x = 4.0 * np.sin(0.1 * np.arange(2000))
    gyro = imu.gyro.copy()
    gyro[:, 1] = np.clip(x, -3.5, 3.5)
    at_end = at_range_end(gyro, 1.0)
    assert not at_end[:, [0, 2]].any()
    np.testing.assert_array_equal(at_end[:, 1], np.abs(x) >= 3.5)
    findings = check_imu_saturation(ImuData(imu.timestamp_ns, gyro, imu.accel))
    assert [f.severity for f in findings] == [Severity.WRONG, Severity.FINE]


def test_a_dead_axis_is_wrong() -> None:
    imu = drive()
    gyro = imu.gyro * [1.0, 0.0, 1.0]
    findings = check_imu_saturation(ImuData(imu.timestamp_ns, gyro, imu.accel))
    assert findings[0].severity is Severity.WRONG
    assert "never changes" in findings[0].says


def test_a_hole_of_years_costs_no_memory() -> None:
    imu = drive()
    far = imu.timestamp_ns + np.where(np.arange(len(imu)) > 1000, 1_500_000_000_000_000_000, 0)
    found = check_accel_unit(ImuData(far, imu.gyro, imu.accel))
    assert found.severity == Severity.FINE
