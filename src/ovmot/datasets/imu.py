"""Checks that every IMU table passes before it is used."""

from pathlib import Path

import numpy as np

from ovmot.datasets.findings import Findings, rising
from ovmot.datasets.text_tables import StampedTable, ns_to_seconds
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.types import ImuData

FASTEST_RPS = 35.0
"""2000 °/s, the widest range of common gyroscopes."""
BY_UNIT = "where gravity alone is 9.81"
"""In the warning about the accelerometer's unit."""
_HARDEST_MPS2 = 400.0  # 40 g, beyond the range of common accelerometers
_MOST_SPIKES = 0.01  # share of the samples
_ACCEL_RANGE = (5.0, 15.0)
_MOST = 1e6  # rad/s or m/s², and raw counts of 20 bits: beyond any sensor
_LEAST_INTERVAL_NS = 30_000  # an IMU of 33 kHz; microseconds of one above 33 Hz are less


def checked_imu(
    table: StampedTable, gyro_first: int, accel_first: int, max_gap_s: float, findings: Findings
) -> ImuData:
    """IMU samples of a table, in time order: each has a later stamp than all rows above.

    `gyro_first`, `accel_first`: columns of the values where each triple begins. Rows left out, gaps
    longer than `max_gap_s` and units that look wrong become counted warnings. Raises `DatasetError`
    with the row where a value is absurd or most stamps do not rise, and for stamps that are no
    nanoseconds.
    """
    fresh = rising(table.timestamp_ns, table.row, table.path, "imu", findings)
    imu = ImuData(
        table.timestamp_ns[fresh],
        table.values[fresh, gyro_first : gyro_first + 3],
        table.values[fresh, accel_first : accel_first + 3],
    )
    _refuse_absurd(imu, table.row[fresh], table.path)
    _note_units(imu, table, findings)
    imu = _without_spikes(imu, table.row[fresh], table.path, findings)
    _note_gaps(imu, table, max_gap_s, findings)
    return imu


def _refuse_absurd(imu: ImuData, row: IntArray, path: Path | str) -> None:
    if len(imu) > 1 and np.median(np.diff(imu.timestamp_ns)) < _LEAST_INTERVAL_NS:
        problem = f"{len(imu)} samples within {np.ptp(imu.timestamp_ns)} ns"
        raise DatasetError.at(path, problem, "stamps are nanoseconds: convert them")
    # NaN is not below either: a bag may hold one
    absurd = ~(np.maximum(np.abs(imu.gyro), np.abs(imu.accel)).max(axis=1) < _MOST)
    if np.any(absurd):
        problem = "holds a rate or an acceleration that no sensor measures"
        first = int(row[int(np.argmax(absurd))])
        raise DatasetError.at(path, problem, "correct or delete the row", row=first)


def _note_gaps(imu: ImuData, table: StampedTable, max_gap_s: float, findings: Findings) -> None:
    gaps_s = np.diff(imu.timestamp_ns) * 1e-9
    count = int(np.count_nonzero(gaps_s > max_gap_s))
    if count:
        worst = int(np.argmax(gaps_s))
        when = ns_to_seconds(int(imu.timestamp_ns[worst]))
        text = (
            f"{table.path}: {count} gaps of more than {max_gap_s:g} s in the IMU,"
            f" the largest {gaps_s[worst]:.3f} s at {when} s"
        )
        findings.note("imu_gaps", count, text)


def _note_units(imu: ImuData, table: StampedTable, findings: Findings) -> None:
    if not is_near_gravity(imu.accel):
        usual = _usual(imu.accel)
        unit = "the unit may be g; convert to m/s²"
        if usual <= 0.5:
            unit = "gravity may have been taken off; write what the sensor measured"
        elif usual >= 1.5:
            unit = "the values may be raw counts; convert to m/s²"
        measured = f"{table.path}: median acceleration {usual:.3g} m/s²"
        text = f"{measured}, {BY_UNIT}: {unit}"
        findings.note("imu_units", 1, text)


def is_near_gravity(accel: FloatArray) -> bool:
    """Do accelerations (N, 3) look as if they were in m/s²?"""
    low, high = _ACCEL_RANGE
    return low <= _usual(accel) <= high


def _usual(accel: FloatArray) -> float:
    return float(np.median(np.linalg.norm(accel, axis=1)))


def _without_spikes(imu: ImuData, row: IntArray, path: Path | str, findings: Findings) -> ImuData:
    """The samples that a sensor can have measured; all of them where too many are no spikes."""
    if not np.any(imu.gyro):
        findings.note("imu_dead", 1, f"{path}: the gyroscope is 0 throughout; check the columns")
    if "imu_units" in findings.counts:
        return imu  # said already, of all rows
    beyond = np.abs(imu.gyro).max(axis=1) > FASTEST_RPS
    beyond |= np.abs(imu.accel).max(axis=1) > _HARDEST_MPS2
    count = int(np.count_nonzero(beyond))
    rare = count <= max(_MOST_SPIKES * len(imu), 1)
    first = int(row[int(np.argmax(beyond))])
    text = (
        f"{path}: {count} rows, the first is row {first}, beyond common sensors"
        f" ({FASTEST_RPS:g} rad/s, {_HARDEST_MPS2:g} m/s²)"
    )
    outcome = "spikes, left out" if rare else "so many are no spikes; check the units"
    findings.note("imu_beyond_range", count, f"{text}: {outcome}")
    kept = ~beyond if rare else np.ones(len(imu), dtype=bool)
    return ImuData(imu.timestamp_ns[kept], imu.gyro[kept], imu.accel[kept])
