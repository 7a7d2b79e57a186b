"""The OXTS packets of KITTI raw: 30 numbers each, in files by number, and the times of the files.

Fields: latitude and longitude in degrees, altitude, roll, pitch, yaw (0: east, counterclockwise),
velocity to north, east, forward, left, up, acceleration `ax ay az` and `af al au`, angular rate
`wx wy wz` and `wf wl wu`, and what tells their accuracy. SI units, radians.
"""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ovmot.datasets.findings import Findings
from ovmot.datasets.text_tables import StampedTable
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import DatasetError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.text_files import read_text

N_FIELDS = 30
ACCEL, GYRO = 11, 17
"""Where `ax ay az` and `wx wy wz` begin."""
_ATTITUDE, _NORTH, _EAST, _UP, _POSITION_ACCURACY = 3, 6, 7, 10, 23
_NO_STAMP = -1
_EARTH_RADIUS_M = 6378137.0  # WGS 84, semi-major axis


def read_times(path: Path) -> IntArray:
    """Nanoseconds of each row `2011-09-26 13:02:25.964389445`; -1 for an empty one."""
    missing = "no such file; it holds the time of each file"
    lines = read_text(path, DatasetError, missing).split("\n")
    stamps = np.full(len(lines), _NO_STAMP, dtype=np.int64)
    for i, line in enumerate(lines):
        text = line.strip()
        if not text:
            continue
        try:
            stamps[i] = _time_ns(text)
        except ValueError:
            remedy = "a row is: year-month-day hour:minute:second.fraction"
            raise DatasetError.at(path, f"'{text[:40]}' is no time", remedy, row=i + 1) from None
    return stamps


def _time_ns(text: str) -> int:
    """Nanoseconds since 1970 of a date and time taken as UTC."""
    whole, _, fraction = text.partition(".")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    if fraction and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(text)
    return int(moment.timestamp()) * 10**9 + int(fraction[:9].ljust(9, "0"))


def stamps_at(stamps: IntArray, numbers: IntArray, path: Path) -> IntArray:
    """The stamps of numbered files; raises `DatasetError` for a file without one."""
    known = np.append(stamps, _NO_STAMP)[np.minimum(numbers, len(stamps))]
    if np.any(known == _NO_STAMP):
        number = int(numbers[int(np.argmax(known == _NO_STAMP))])
        problem = f"no time for the file of number {number}"
        raise DatasetError.at(path, problem, "row n is the time of file n - 1", row=number + 1)
    return known


def read_packets(oxts: Path, findings: Findings) -> StampedTable:
    """The packets of `oxts/data` in time order; those not later than all before them are dropped.

    Some `extract` drives have packets out of order: their stamps are the receiver's. Raises
    `DatasetError` with the file for what cannot be read.
    """
    files = {int(p.stem): p for p in (oxts / "data").glob("*.txt") if p.stem.isdigit()}
    if not files:
        raise DatasetError.at(oxts / "data", "no samples in this folder", "copy it again")
    numbers = np.array(sorted(files), dtype=np.int64)
    times = oxts / "timestamps.txt"
    stamps = stamps_at(read_times(times), numbers, times)
    latest = np.maximum.accumulate(stamps)
    fresh = np.concatenate([[True], stamps[1:] > latest[:-1]])
    late = int(np.count_nonzero(~fresh))
    text = f"{oxts}: {late} samples that do not lie after the one before: dropped"
    findings.note("imu_out_of_order", late, text)
    values = read_fields([files[int(n)] for n in numbers[fresh]])
    return StampedTable(times, stamps[fresh], values, numbers[fresh] + 1)


def read_fields(files: list[Path]) -> FloatArray:
    """The numbers (N, 30) of N files, one packet each."""
    return np.array([_fields(path, read_text(path, DatasetError)) for path in files])


def _fields(path: Path, text: str) -> FloatArray:
    """The 30 numbers of one OXTS packet."""
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise DatasetError.at(path, f"cannot be read: {error}", "copy it again") from None
    if len(values) != N_FIELDS or not np.all(np.isfinite(values)):
        problem = f"{len(values)} numbers where {N_FIELDS} finite ones are expected"
        raise DatasetError.at(path, problem, "copy it again")
    return values


def read_rows(path: Path) -> FloatArray:
    """The numbers (N, 30) of a file with a packet a row, as KITTI tracking has them."""
    rows = [row for row in read_text(path, DatasetError).splitlines() if row.strip()]
    return np.array([_fields(path, row) for row in rows]).reshape(-1, N_FIELDS)


def true_poses(path: Path, timestamp_ns: IntArray, packets: FloatArray) -> EgoTruth:
    """The IMU's poses and velocities by OXTS packets (N, 30) at stamps (N,).

    The world has x east, y north, z up, and its origin at the first packet. Positions are Mercator
    projections at the first latitude, rotations Rz(yaw) Ry(pitch) Rx(roll), as the data set's own
    development kit takes them (A. Geiger et al., IJRR 2013). The accuracy of the positions is what
    each packet states for the horizontal (`pos_accuracy`); for the height it states none.
    """
    latitude, longitude, altitude = packets[:, 0], packets[:, 1], packets[:, 2]
    scale_m = np.cos(np.radians(latitude[0])) * _EARTH_RADIUS_M
    position = np.stack(
        [
            scale_m * np.radians(longitude),
            scale_m * np.log(np.tan(0.25 * np.pi + 0.5 * np.radians(latitude))),
            altitude,
        ],
        axis=-1,
    )
    axes = np.eye(3)
    roll, pitch, yaw = packets[:, _ATTITUDE : _ATTITUDE + 3].T
    R = so3.exp(yaw[:, None] * axes[2]) @ so3.exp(pitch[:, None] * axes[1])
    R = R @ so3.exp(roll[:, None] * axes[0])
    velocity = packets[:, [_EAST, _NORTH, _UP]]
    T, sigma_m = se3.make(R, position - position[0]), packets[:, _POSITION_ACCURACY]
    return EgoTruth(path, timestamp_ns, T, velocity, position_sigma_m=sigma_m)
