"""The objects of a run: their paths for the map, and a row for each of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ovmot.datasets.truth import ObjectTruth
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.motion_class import CLASSES
from ovmot.outputs.finished_run import Rows
from ovmot.outputs.objects_overlay import class_word
from ovmot.report.numbers import listed, number
from ovmot.report.world import Placed
from ovmot.types import ObjectTrack

_OUTLINE = ("x", "y", "yaw", "length", "width")


@dataclass(frozen=True, slots=True)
class Path:
    """The confirmed rows of one track, and its class in a word, empty where none is sure."""

    track_id: int
    rows: Rows
    kind: str

    @property
    def speed(self) -> FloatArray:
        """Speed (N,), m/s."""
        speed: FloatArray = np.linalg.norm(columns(self.rows, "vx", "vy", "vz"), axis=1)
        return speed


def paths_of(tracks: Rows) -> tuple[Path, ...]:
    """The confirmed tracks in order of their ids."""
    if len(tracks) == 0:
        return ()
    confirmed = tracks[tracks["state"] == "confirmed"]
    order = np.argsort(confirmed["track_id"], kind="stable")
    sorted_rows = confirmed[order]
    ids, starts = np.unique(sorted_rows["track_id"], return_index=True)
    parts = np.split(sorted_rows, starts[1:]) if len(ids) else []
    return tuple(
        Path(int(track_id), rows, kind_of(rows))
        for track_id, rows in zip(ids, parts, strict=True)
    )  # fmt: skip


def kind_of(rows: Rows) -> str:
    """The class of motion of a track, as last known; empty where none is sure."""
    probability = _class_probability(rows)
    known = probability[np.all(np.isfinite(probability), axis=1)]
    return class_word(known[-1]) if len(known) else ""


def _class_probability(rows: Rows) -> FloatArray:
    """Probabilities (N, 3) of the classes; NaN in a run of before they were written."""
    names = tuple(f"p_{kind}" for kind in CLASSES)
    if not set(names) <= set(rows.dtype.names or ()):
        return np.full((len(rows), len(CLASSES)), np.nan)
    return columns(rows, *names)


def columns(rows: Rows, *names: str) -> FloatArray:
    """Columns (N, K) of a table."""
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def object_tracks(rows: Rows) -> tuple[ObjectTrack, ...]:
    """The rows of one frame as the overlay takes them."""
    return tuple(
        ObjectTrack(
            int(row["track_id"]), str(row["state"]), _vector(row, "x", "y", "z"),
            _vector(row, "vx", "vy", "vz"), float(row["yaw"]), float(row["yaw_rate"]),
            _vector(row, "length", "width", "height"),
            _vector(row, "u_min", "v_min", "u_max", "v_max"), int(row["n_points"]),
            _vector(row, "std_x", "std_y", "std_z"), _vector(row, "std_vx", "std_vy", "std_vz"),
            probability,
        )
        for row, probability in zip(rows, _class_probability(rows), strict=True)
    )  # fmt: skip


def map_paths(
    paths: tuple[Path, ...], placed: Placed, frames: IntArray, most_rows: int
) -> list[dict[str, Any]]:
    """Paths in the page's world at the grid of frames (stamps (N,), ns): for map and plots.

    `at` are indices into that grid. The longest ones come, up to so many rows altogether.
    """
    shown, left = [], most_rows
    for path in sorted(paths, key=lambda p: -len(p.rows)):
        at = np.searchsorted(frames, path.rows["timestamp_ns"])
        there = (at < len(frames)) & (
            frames[np.minimum(at, len(frames) - 1)] == path.rows["timestamp_ns"]
        )
        left -= int(there.sum())
        if left < 0:
            break
        shown.append(_map_path(path, path.rows[there], path.speed[there], at[there], placed))
    return sorted(shown, key=lambda entry: int(entry["id"]))


def true_paths(truth: ObjectTruth, frames: IntArray, most_rows: int) -> list[dict[str, Any]]:
    """True paths of the objects that the left camera sees, at the grid of frames, for the map.

    `at` are indices into that grid. The longest ones come, up to so many rows altogether.
    """
    rows: dict[int, list[list[float]]] = {}
    for at, stamp in enumerate(frames.tolist()):
        objects = truth.frames.get(stamp)
        if objects is None:
            continue
        for k in np.flatnonzero(objects.visible_px > 0):
            row = [at, *objects.center[k, :2], objects.yaw[k], *objects.size[k, :2]]
            rows.setdefault(int(objects.object_id[k]), []).append(row)
    longest = sorted(rows.values(), key=lambda path: -len(path))
    used = np.cumsum([len(path) for path in longest])
    return [
        {"at": [int(row[0]) for row in path]}
        | dict(zip(_OUTLINE, listed(np.array(path)[:, 1:].T, 2), strict=True))
        for path, total in zip(longest, used, strict=True)
        if total <= most_rows
    ]


def object_rows(
    paths: tuple[Path, ...], ego: FloatArray, start_ns: int, frame_ns: IntArray
) -> list[dict[str, Any]]:
    """A row of numbers for each object; `ego` (N, 3) is the rig in the run's world at `frame_ns`.

    Times are seconds since `start_ns`.
    """
    return [_object_row(path, ego, start_ns, frame_ns) for path in paths]


def _object_row(path: Path, ego: FloatArray, start_ns: int, frame_ns: IntArray) -> dict[str, Any]:
    stamps, speed = path.rows["timestamp_ns"], path.speed
    at = np.minimum(np.searchsorted(frame_ns, stamps), len(frame_ns) - 1)
    distance = np.linalg.norm(columns(path.rows, "x", "y", "z") - ego[at], axis=1)
    size = np.median(columns(path.rows, "length", "width", "height"), axis=0)
    return {
        "id": path.track_id,
        "kind": path.kind,
        "first": number(1e-9 * (stamps[0] - start_ns), 2),
        "seconds": number(1e-9 * (stamps[-1] - stamps[0]), 2),
        "frames": len(stamps),
        "speed": number(float(np.median(speed)), 2),
        "fastest": number(float(speed.max()), 2),
        "nearest": number(float(distance.min()), 1),
        "size": listed(size, 1),
        "points": number(float(np.median(path.rows["n_points"])), 0),
    }


def _map_path(
    path: Path, rows: Rows, speed: FloatArray, at: IntArray, placed: Placed
) -> dict[str, Any]:
    position = placed.positions(columns(rows, "x", "y", "z"))
    return {
        "id": path.track_id,
        "kind": path.kind,
        "at": at.tolist(),
        "x": listed(position[:, 0], 2),
        "y": listed(position[:, 1], 2),
        "yaw": listed(placed.yaw(rows["yaw"]), 3),
        "length": listed(rows["length"], 2),
        "width": listed(rows["width"], 2),
        "speed": listed(speed, 2),
    }


def _vector(row: np.void, *names: str) -> FloatArray:
    return np.array([float(row[name]) for name in names])
