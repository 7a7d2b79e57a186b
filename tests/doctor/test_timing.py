"""Stamps: rates, jitter, holes."""

import numpy as np
import pytest

from ovmot.doctor.report import Finding, Severity
from ovmot.doctor.timing import (
    check_coverage,
    check_frame_times,
    check_imu_times,
    lost_in_holes,
)
from ovmot.geometry.arrays import IntArray
from ovmot.settings import ImuSettings

PERIOD_NS = 50_000_000


def stamps(n: int, period_ns: int = PERIOD_NS) -> IntArray:
    return 1_500_000_000_000_000_000 + period_ns * np.arange(n, dtype=np.int64)


def severities(findings: list[Finding]) -> dict[str, Severity]:
    return {f.check: f.severity for f in findings}


def test_even_stamps_are_fine() -> None:
    for findings in (
        check_frame_times(stamps(200), {}),
        check_imu_times(stamps(2000, 5_000_000), {}, ImuSettings()),
    ):
        assert set(severities(findings).values()) == {Severity.FINE}


def test_dropped_frames_are_counted() -> None:
    left = np.delete(stamps(200), [10, 50, 51])
    assert lost_in_holes(np.diff(left) * 1e-9, 0.05) == 3
    found = check_frame_times(left, {"unpaired_images": 3})[2]
    assert found.severity is Severity.DOUBTFUL
    assert found.says.startswith("3 of 200 stereo pairs are missing (1.5%)")
    assert "images without a partner: 3" in found.says
    many = check_frame_times(np.delete(stamps(200), range(100, 112)), {})
    assert severities(many)["dropped frames"] is Severity.WRONG


def test_jitter_is_doubtful() -> None:
    rng = np.random.default_rng(0)
    shaken = stamps(200) + rng.normal(0.0, 0.1 * PERIOD_NS, 200).astype(np.int64)
    assert severities(check_frame_times(shaken, {}))["frame jitter"] is Severity.DOUBTFUL


def test_slow_sensors_are_doubtful() -> None:
    assert severities(check_frame_times(stamps(20, 10**9), {}))["frame rate"] is Severity.DOUBTFUL
    slow = check_imu_times(stamps(200), {}, ImuSettings())
    assert severities(slow)["IMU rate"] is Severity.DOUBTFUL


def test_imu_holes() -> None:
    imu = stamps(2000, 5_000_000)
    cases = ((30, Severity.WRONG), (8, Severity.DOUBTFUL), (1, Severity.FINE))
    for width, severity in cases:
        holed = np.delete(imu, range(1000, 1000 + width))
        assert severities(check_imu_times(holed, {}, ImuSettings()))["IMU gaps"] is severity


def test_single_pair_is_no_error() -> None:
    assert severities(check_frame_times(stamps(1), {})) == {"frame rate": Severity.UNKNOWN}


@pytest.mark.parametrize(
    ("outside", "severity"),
    [(0, Severity.FINE), (2, Severity.FINE), (20, Severity.DOUBTFUL), (150, Severity.WRONG)],
)
def test_frames_that_the_imu_does_not_cover(outside: int, severity: Severity) -> None:
    found = check_coverage(100, {"frames_outside_imu": outside})
    assert found.severity is severity
    assert f"100 of {100 + outside}" in found.says
