"""Checks that every IMU table passes before it is used."""

import numpy as np

from ovmot.datasets.findings import Findings
from ovmot.errors import DatasetError
from ovmot.formats import StampedTable, ns_to_seconds
from ovmot.types import ImuData

_ACCEL_RANGE = (5.0, 15.0)


def checked_imu(
    table: StampedTable, gyro_first: int, accel_first: int, max_gap_s: float, findings: Findings
) -> ImuData:
    """IMU samples of a table, in time order, equal stamps once.

    `gyro_first`, `accel_first`: columns of the values where each triple begins. Gaps longer than
    `max_gap_s` and units that look wrong become counted warnings. Raises `DatasetError` with the
    row where stamps run backwards.
    """
    steps = np.diff(table.timestamp_ns)
    if np.any(steps < 0):
        row = int(table.row[int(np.argmax(steps < 0)) + 1])
        problem = "the stamp lies before that of the row above"
        raise DatasetError.at(table.path, problem, "sort the file by time", row=row)
    doubles = int(np.count_nonzero(steps == 0))
    text = f"{table.path}: {doubles} IMU rows with the stamp of the row above: dropped"
    findings.note("imu_duplicates", doubles, text)
    fresh = np.concatenate([[True], steps > 0])
    imu = ImuData(
        table.timestamp_ns[fresh],
        table.values[fresh, gyro_first : gyro_first + 3],
        table.values[fresh, accel_first : accel_first + 3],
    )
    _note_gaps(imu, table, max_gap_s, findings)
    _note_units(imu, table, findings)
    return imu


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
    mean = float(np.linalg.norm(imu.accel, axis=1).mean())
    low, high = _ACCEL_RANGE
    if not low <= mean <= high:
        unit = "the unit may be g" if 0.5 < mean < 1.5 else "the values may be raw counts"
        text = (
            f"{table.path}: mean acceleration {mean:.3g} m/s², where gravity alone is 9.81:"
            f" {unit}; convert to m/s²"
        )
        findings.note("imu_units", 1, text)
