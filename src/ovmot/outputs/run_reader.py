"""A finished run read back from its folder: poses, states, tracks, points, stereo matches."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ovmot.datasets.pose_files import read_written_tum
from ovmot.errors import InputError
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray

TIME_OFFSET = "time_offset_s"
_AXES = ("x", "y", "z")
_VELOCITY = tuple(f"v{a}" for a in _AXES)
_BIASES = tuple(f"{sensor}_bias_{a}" for sensor in ("gyro", "accel") for a in _AXES)
_SIGMAS = tuple(
    f"std_{part}{a}" for part in ("rotation_", "", "v", "gyro_bias_", "accel_bias_") for a in _AXES
)
_STATE = ("rx", "ry", "rz", "x", "y", "z", "vx", "vy", "vz")
_UPPER = np.triu_indices(len(_STATE))
_COVARIANCE = tuple(f"cov_{_STATE[i]}_{_STATE[j]}" for i, j in zip(*_UPPER, strict=True))
LABELS = ("unknown", "static", "dynamic")
_POSITION, _VELOCITY = ("x", "y", "z"), ("vx", "vy", "vz")
_SIZE = ("length", "width", "height")
_STD = ("std_x", "std_y", "std_z", "std_vx", "std_vy", "std_vz")
_STD_BOX = ("std_length", "std_width", "std_height", "std_yaw", "std_yaw_rate")
REMEDY = "run it again, or give another run"


@dataclass(frozen=True, slots=True)
class EgoRun:
    """Poses `T_world_imu` (N, 4, 4) of a run at rising stamps (N,), and the state and its
    uncertainty.

    `velocity` (N, 3) in m/s in the world, `gyro_bias` and `accel_bias` (N, 3); `sigma` (N, 15)
    over rotation (right perturbation), position, velocity and the two biases; `covariance`
    (N, 9, 9) over rotation, position, velocity. None where the run lacks the file, NaN in a row
    that lacks a value.
    """

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray | None = None
    gyro_bias: FloatArray | None = None
    accel_bias: FloatArray | None = None
    sigma: FloatArray | None = None
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Tracks:
    """Rows (M,) of confirmed tracks in the run's world, one per track and frame; SI units.

    `position`, `velocity` and `size` (M, 3), size as length, width, height; `yaw` and `yaw_rate`
    (M,); `std` (M, 6): standard deviation of position and velocity; `std_box` (M, 5): of length,
    width, height, yaw and yaw rate, NaN where the run does not say. `timestamp_ns`, `track_id`
    (M,).
    """

    timestamp_ns: IntArray
    track_id: IntArray
    position: FloatArray
    velocity: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    size: FloatArray
    std: FloatArray
    std_box: FloatArray

    def at(self, timestamp_ns: int) -> "Tracks":
        """The rows of one frame."""
        return self.rows(self.timestamp_ns == timestamp_ns)

    def rows(self, kept: BoolArray | IntArray) -> "Tracks":
        """Some of the rows."""
        return Tracks(
            self.timestamp_ns[kept], self.track_id[kept], self.position[kept], self.velocity[kept],
            self.yaw[kept], self.yaw_rate[kept], self.size[kept], self.std[kept],
            self.std_box[kept],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class LabelledPoints:
    """Rows (M,) of `points.csv`: left pixel (M, 2), depth (M,) or NaN, index into `LABELS`."""

    timestamp_ns: IntArray
    pixel: FloatArray
    depth: FloatArray
    label: IntArray


@dataclass(frozen=True, slots=True)
class GatedMatches:
    """Rows (M,) of `stereo.csv`: pixels (M, 4) of both images, and whether the gate accepted the
    match.
    """

    timestamp_ns: IntArray
    pixels: FloatArray
    accepted: BoolArray


@dataclass(frozen=True, slots=True)
class CalibrationDeviations:
    """Deviations (N, C) of the named coordinates from the calibration that the run was given.

    `names` (C,) are the columns of `calibration.csv`, and `TIME_OFFSET`, whose value is the whole
    offset in s; `sigma` (N, C) is the standard deviation of each. Rotations in rad (right
    perturbation), positions in m, intrinsics in pixels; N stamps in ns.
    """

    timestamp_ns: IntArray
    names: tuple[str, ...]
    value: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of a file: stamps (N,) in ns, numbers (N, K), and one list of texts for each column."""

    timestamp_ns: IntArray
    values: FloatArray
    texts: dict[str, list[str]]


def read_ego_run(run: Path) -> EgoRun:
    """The poses of a run's folder, with `state.csv` and `covariance.csv` where the run has them.

    Raises `InputError` for a folder that is no run and for files that cannot be used.
    """
    path = run / "trajectory.tum"
    if not run.is_dir():
        problem = "is not a folder" if run.exists() else "no such folder"
        raise InputError.at(run, problem, "give the output folder of 'ovmot run'")
    if not path.is_file():
        raise InputError.at(
            run, "is not a run: it holds no trajectory.tum", "give the output folder of 'ovmot run'"
        )
    trajectory = read_written_tum(path)
    stamps = trajectory.timestamp_ns
    state = _columns_at(run / "state.csv", (*_VELOCITY, *_BIASES, *_SIGMAS), stamps)
    upper = _columns_at(run / "covariance.csv", _COVARIANCE, stamps)
    poses = EgoRun(stamps, trajectory.T_world_imu)
    if state is not None:
        velocity, gyro_bias, accel_bias, sigma = np.split(state, (3, 6, 9), axis=1)
        poses = EgoRun(stamps, trajectory.T_world_imu, velocity, gyro_bias, accel_bias, sigma)
    if upper is None:
        return poses
    return replace(poses, covariance=_symmetric(upper))


def read_tracks(run: Path) -> Tracks | None:
    """The confirmed tracks of a run, None where it has no `tracks.csv`; raises `InputError`."""
    path = run / "tracks.csv"
    if not path.is_file():
        return None
    columns = ("track_id", *_POSITION, *_VELOCITY, "yaw", "yaw_rate", *_SIZE, *_STD)
    table = read_table(path, columns, ("state",), optional=_STD_BOX)
    parts = np.split(table.values, (1, 4, 7, 8, 9, 12, 18), axis=1)
    tracks = Tracks(
        table.timestamp_ns, parts[0][:, 0].astype(np.int64), parts[1], parts[2], parts[3][:, 0],
        parts[4][:, 0], parts[5], parts[6], parts[7],
    )  # fmt: skip
    confirmed = np.array([state == "confirmed" for state in table.texts["state"]], dtype=np.bool_)
    tracks = tracks.rows(confirmed)
    twice = np.stack([tracks.timestamp_ns, tracks.track_id])
    if len(np.unique(twice, axis=1).T) != len(tracks.track_id):
        raise InputError.at(path, "holds a track twice in one frame", REMEDY)
    return tracks


def read_points(run: Path) -> LabelledPoints | None:
    """The labelled points of a run, None where it has no `points.csv`; raises `InputError`."""
    path = run / "points.csv"
    if not path.is_file():
        return None
    table = read_table(path, ("u", "v", "z_cam"), ("label",))
    number = {name: i for i, name in enumerate(LABELS)}
    labels = table.texts["label"]
    for row, label in enumerate(labels, start=2):
        if label not in number:
            raise InputError.at(path, f"'{label}' is no label", REMEDY, row=row)
    return LabelledPoints(
        table.timestamp_ns, table.values[:, :2], table.values[:, 2],
        np.array([number[label] for label in labels], dtype=np.int64),
    )  # fmt: skip


def read_matches(run: Path) -> GatedMatches | None:
    """The tested stereo matches of a run, None without `stereo.csv`; raises `InputError`."""
    path = run / "stereo.csv"
    if not path.is_file():
        return None
    table = read_table(path, ("u", "v", "u_right", "v_right", "accepted"))
    return GatedMatches(table.timestamp_ns, table.values[:, :4], table.values[:, 4] > 0.5)


def read_calibration(run: Path) -> CalibrationDeviations | None:
    """The online calibration of a run, None where it estimated none; raises `InputError`.

    The time offset is included where it was estimated: where it has a standard deviation.
    """
    path = run / "calibration.csv"
    if not path.is_file() or path.stat().st_size == 0:
        return None
    with path.open(encoding="utf-8") as file:
        columns = file.readline().strip().split(",")
    names = tuple(name for name in columns if f"std_{name}" in columns)
    table = read_table(path, (*names, *(f"std_{name}" for name in names)))
    clock = read_table(run / "state.csv", (TIME_OFFSET, f"std_{TIME_OFFSET}")).values
    value, sigma = np.split(table.values, 2, axis=1)
    if (clock[:, 1] > 0.0).all():
        names = (*names, TIME_OFFSET)
        value, sigma = np.c_[value, clock[:, 0]], np.c_[sigma, clock[:, 1]]
    return CalibrationDeviations(table.timestamp_ns, names, value, sigma)


def read_table(
    path: Path,
    columns: tuple[str, ...],
    texts: tuple[str, ...] = (),
    optional: tuple[str, ...] = (),
) -> Table:
    """The column `timestamp_ns`, the named columns of numbers and those of text.

    An empty field of numbers is NaN, and so is a whole column of the `optional` ones, which come
    behind the others, where the file lacks it. Raises `InputError` with the row of whatever is
    wrong.
    """
    stamps: list[int] = []
    values: list[list[float]] = []
    found: dict[str, list[str]] = {name: [] for name in texts}
    rows = _rows(path)
    header = next(rows, None)
    if header is None:
        raise InputError.at(path, "is empty", REMEDY)
    missing = [name for name in ("timestamp_ns", *columns, *texts) if name not in header]
    if missing:
        raise InputError.at(path, f"has no column '{missing[0]}'", REMEDY, row=1)
    at = header.index("timestamp_ns")
    where = [header.index(name) for name in columns]
    extra = [header.index(name) if name in header else None for name in optional]
    where_text = {name: header.index(name) for name in texts}
    for number, fields in enumerate(rows, start=2):
        if len(fields) != len(header):
            problem = f"{len(fields)} columns where {len(header)} are expected"
            raise InputError.at(path, problem, REMEDY, row=number)
        try:
            stamps.append(int(fields[at]))
            numbers = [float(fields[k] or "nan") for k in where]
            numbers += [float("nan" if k is None else fields[k] or "nan") for k in extra]
            values.append(numbers)
        except ValueError as error:
            raise InputError.at(path, f"is not a number: {error}", REMEDY, row=number) from None
        for name, k in where_text.items():
            found[name].append(fields[k])
    array = np.array(values, dtype=np.float64).reshape(-1, len(columns) + len(optional))
    return Table(np.array(stamps, dtype=np.int64), array, found)


def _symmetric(upper: FloatArray) -> FloatArray:
    """Matrices (N, 9, 9) of their upper triangles (N, 45), row by row."""
    matrix = np.empty((len(upper), len(_STATE), len(_STATE)))
    i, j = _UPPER
    matrix[:, i, j] = upper
    matrix[:, j, i] = upper
    return matrix


def _columns_at(path: Path, columns: tuple[str, ...], stamps: IntArray) -> FloatArray | None:
    """Columns (N, K) of a table at the stamps (N,), NaN where it has no such row.

    None where there is no such file. Raises `InputError` for a table without these columns,
    with a row that is broken, or with none of the stamps.
    """
    if not path.is_file():
        return None
    table = read_table(path, columns)
    row_of = {stamp: row for row, stamp in enumerate(table.timestamp_ns.tolist())}
    rows = np.array([row_of.get(stamp, -1) for stamp in stamps.tolist()], dtype=np.int64)
    if np.all(rows < 0):
        raise InputError.at(path, "has no row for any stamp of trajectory.tum", REMEDY)
    out = np.full((len(stamps), len(columns)), np.nan)
    out[rows >= 0] = table.values[rows[rows >= 0]]
    return out


def _rows(path: Path) -> Iterator[list[str]]:
    """The rows of a table; a last one without its end was torn when the run was killed."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            yield from csv.reader(line for line in file if line.endswith("\n"))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError.at(path, f"cannot be read as a table: {error}", REMEDY) from None
