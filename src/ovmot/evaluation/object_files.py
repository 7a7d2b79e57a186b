"""What a run says of moving objects, of points and of stereo matches, read back from its folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.errors import InputError
from ovmot.evaluation.table_files import REMEDY, read_table
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray

LABELS = ("unknown", "static", "dynamic")
_POSITION, _VELOCITY = ("x", "y", "z"), ("vx", "vy", "vz")
_SIZE = ("length", "width", "height")
_STD = ("std_x", "std_y", "std_z", "std_vx", "std_vy", "std_vz")


@dataclass(frozen=True, slots=True)
class Tracks:
    """Rows (M,) of confirmed tracks, in the run's world: SI units, one row per track and frame.

    `std` (M, 6): one-sigma of position and velocity.
    """

    timestamp_ns: IntArray
    track_id: IntArray
    position: FloatArray
    velocity: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    size: FloatArray
    std: FloatArray

    def at(self, timestamp_ns: int) -> "Tracks":
        """The rows of one frame."""
        return self.rows(self.timestamp_ns == timestamp_ns)

    def rows(self, kept: BoolArray | IntArray) -> "Tracks":
        """Some of the rows."""
        return Tracks(
            self.timestamp_ns[kept], self.track_id[kept], self.position[kept], self.velocity[kept],
            self.yaw[kept], self.yaw_rate[kept], self.size[kept], self.std[kept],
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
    """Rows (M,) of `stereo.csv`: pixels (M, 4) of both images, and the gate's verdict."""

    timestamp_ns: IntArray
    pixels: FloatArray
    accepted: BoolArray


def read_tracks(run: Path) -> Tracks | None:
    """The confirmed tracks of a run, None where it has no `tracks.csv`; raises `InputError`."""
    path = run / "tracks.csv"
    if not path.is_file():
        return None
    columns = ("track_id", *_POSITION, *_VELOCITY, "yaw", "yaw_rate", *_SIZE, *_STD)
    table = read_table(path, columns, ("state",))
    parts = np.split(table.values, (1, 4, 7, 8, 9, 12), axis=1)
    tracks = Tracks(
        table.timestamp_ns, parts[0][:, 0].astype(np.int64), parts[1], parts[2], parts[3][:, 0],
        parts[4][:, 0], parts[5], parts[6],
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
