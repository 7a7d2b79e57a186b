"""The gyroscope against a camera that turns in a known way."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.doctor.camera_rotations import CameraRotations
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Severity
from ovmot.doctor.time_offset import check_gyro, fit_gyro
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.rigs import R_AHEAD
from ovmot.types import ImuData

ORIGIN_NS = 1_500_000_000_000_000_000
SIGMA_S = 0.005
_HZ = np.array([0.31, 0.83, 1.37])


def rates(t: FloatArray, size: float) -> FloatArray:
    """Rates (N, 3) of the IMU, rad/s."""
    return size * np.sin(2.0 * np.pi * _HZ * t[:, None] + [0.0, 1.0, 2.0]) * [1.0, 0.4, 0.8]


def recorded(
    lag_s: float = 0.0, unit: float = 1.0, size: float = 0.3, R_imu_cam0: FloatArray = R_AHEAD
) -> tuple[CameraRotations, ImuData]:
    """Six seconds of turns at 10 Hz, and an IMU whose clock is `lag_s` ahead."""
    rng = np.random.default_rng(1)
    t = np.arange(-1.0, 7.0, 0.005)
    gyro = unit * (rates(t, size) + 0.003 + rng.normal(0.0, 2e-3, (len(t), 3)))
    imu_ns = ORIGIN_NS + np.round(1e9 * (t + lag_s)).astype(np.int64)
    at = np.arange(0.0, 6.0, 0.1)
    fine = at[:-1, None] + np.arange(0.0025, 0.1, 0.005)
    mean = rates(fine.ravel(), size).reshape(len(fine), -1, 3).mean(axis=1)
    rotation = 0.1 * mean @ R_imu_cam0 + rng.normal(0.0, 3e-4, (len(fine), 3))
    ns = ORIGIN_NS + np.round(1e9 * at).astype(np.int64)
    accel = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    turns = CameraRotations(ns[:-1], ns[1:], rotation, np.zeros_like(rotation))
    return turns, ImuData(imu_ns, gyro, accel)


@pytest.mark.parametrize("lag_s", [-0.12, -0.0173, 0.0, 0.0041, 0.05])
@pytest.mark.parametrize("unit", [1.0, 180.0 / np.pi, -1.0])
def test_the_lag_is_found_in_any_unit(lag_s: float, unit: float) -> None:
    found = fit_gyro(*recorded(lag_s, unit), offset_s=0.0)
    assert found is not None
    assert abs(found.lag_s - lag_s) < max(4.0 * found.lag_std_s, 5e-4)
    assert found.lag_std_s < 1e-3
    assert found.agreement > 0.98


def test_a_known_offset_is_taken_off() -> None:
    found = fit_gyro(*recorded(0.05), offset_s=0.05)
    assert found is not None
    assert abs(found.lag_s) < 1e-3


def severities(
    turns: CameraRotations, imu: ImuData, R_imu_cam0: FloatArray = R_AHEAD
) -> dict[str, Severity]:
    found = check_gyro(fit_gyro(turns, imu, 0.0), R_imu_cam0, 0.0, SIGMA_S, Locations())
    return {f.check: f.severity for f in found}


@pytest.mark.parametrize(
    ("lag_s", "severity"),
    [(0.002, Severity.FINE), (0.05, Severity.DOUBTFUL), (-0.3, Severity.WRONG)],
)
def test_severity_of_an_offset(lag_s: float, severity: Severity) -> None:
    assert severities(*recorded(lag_s))["time offset"] is severity


def test_degrees_are_named() -> None:
    turns, imu = recorded(unit=180.0 / np.pi)
    found = check_gyro(fit_gyro(turns, imu, 0.0), R_AHEAD, 0.0, SIGMA_S, Locations())
    unit = next(f for f in found if f.check == "gyroscope unit")
    assert unit.severity is Severity.WRONG
    assert "π/180" in unit.remedy


@pytest.mark.parametrize("degrees", [(0.0, 0.0, 30.0), (30.0, 0.0, 0.0), (0.0, 180.0, 0.0)])
def test_a_wrong_mount_is_wrong(degrees: tuple[float, float, float]) -> None:
    R = R_AHEAD @ so3.exp(np.radians(degrees))
    found = severities(*recorded(), R)
    assert found["camera on IMU"] is Severity.WRONG
    assert found["time offset"] is Severity.FINE


def test_a_flipped_axis_is_wrong() -> None:
    turns, imu = recorded()
    flipped = ImuData(imu.timestamp_ns, imu.gyro * [1.0, -1.0, 1.0], imu.accel)
    assert severities(turns, flipped)["camera on IMU"] is Severity.WRONG


def test_a_standing_rig_tells_nothing() -> None:
    turns, imu = recorded(size=0.0)
    found = check_gyro(fit_gyro(turns, imu, 0.0), R_AHEAD, 0.0, SIGMA_S, Locations())
    assert {f.severity for f in found} == {Severity.UNKNOWN}
    assert all(f.says.startswith("the rig hardly turns") for f in found)


def test_an_unrelated_gyroscope_is_doubtful() -> None:
    turns, imu = recorded()
    noise = np.random.default_rng(2).normal(0.0, 0.3, imu.gyro.shape)
    found = severities(turns, ImuData(imu.timestamp_ns, noise, imu.accel))
    assert found == {"gyroscope and images": Severity.DOUBTFUL}


def test_images_that_tell_no_rotation() -> None:
    turns, imu = recorded()
    blind = replace(turns, rotation=np.full_like(turns.rotation, np.nan))
    assert set(severities(blind, imu).values()) == {Severity.UNKNOWN}
