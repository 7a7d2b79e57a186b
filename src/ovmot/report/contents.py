"""What a page tells of a run: everything that its script draws, as values of JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import ovmot
from ovmot.errors import InputError
from ovmot.evaluation.consistency import chi_squared_bounds
from ovmot.evaluation.ego import EgoMetrics
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.outputs.finished_run import Rows, Run
from ovmot.report.numbers import grid, listed, number, spans
from ovmot.report.pictures import Pictures, pictures_of
from ovmot.report.remedies import remedy_of, remedy_of_ending
from ovmot.report.tracks import columns, map_paths, object_rows, paths_of, true_paths
from ovmot.report.world import Placed, placed_runs
from ovmot.settings import Settings, describe_settings

_PICTURES_BYTES = 11_000_000
"""Of all runs together; with everything else a page stays under 15 MB."""
_MOST_ROWS = 40_000
"""Of the objects' paths, of all runs together: two megabytes."""
_MOST_SAMPLES = 2400
"""Of a line in a plot: more than a screen has pixels."""
_LEAST_SAMPLES = 600
_SIGMAS = ("std_rotation_x", "std_rotation_y", "std_rotation_z", "std_x", "std_y", "std_z")
_NEES_PARTS = ("orientation", "position")
_STAGES = {
    "start": "initialize", "predict": "propagate", "match": "track", "split": "segment",
    "correct": "update", "forget": "marginalize",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Room:
    """How much of a page one run may take: bytes of pictures, rows of paths, samples of a line."""

    picture_bytes: int
    path_rows: int
    samples: int


def page_contents(runs: Sequence[Run], truth: Path | None = None) -> dict[str, Any]:
    """The page of some runs; see `run_contents`. Raises `InputError` where a run is broken."""
    placed = placed_runs(runs, truth)
    n = len(placed)
    room = Room(
        _PICTURES_BYTES // n, _MOST_ROWS // n, max(_MOST_SAMPLES // max(n // 2, 1), _LEAST_SAMPLES)
    )
    names = run_names([run.folder for run in runs])
    starts = [_start_ns(run) for run in runs]
    # runs of one recording share their time, others start together
    ends = [int(run.state["timestamp_ns"][-1]) for run in runs]
    together = max(starts) <= min(ends)
    zeros = [min(starts)] * len(runs) if together else starts
    return {
        "ovmot": ovmot.__version__,
        "runs": [
            run_contents(one, name, zero, room)
            for one, name, zero in zip(placed, names, zeros, strict=True)
        ],
    }


def run_contents(placed: Placed, name: str, zero_ns: int, room: Room) -> dict[str, Any]:
    """One run; times are seconds since `zero_ns`."""
    run = placed.run
    state, summary = run.state, _summary(run)
    frame_ns = state["timestamp_ns"]
    kept = grid(len(state), room.samples)
    seconds = 1e-9 * (frame_ns - zero_ns)
    position = columns(state, "x", "y", "z")
    on_page = placed.positions(position)[kept]
    speed = np.linalg.norm(columns(state, "vx", "vy", "vz"), axis=1)
    paths = paths_of(_tracks(run))
    pictures = pictures_of(run, room.picture_bytes)
    objects = object_rows(paths, position, zero_ns, frame_ns)
    return {
        "name": name,
        "folder": str(run.folder),
        "ended": str(summary.get("ended", "unknown")),
        "remedy": remedy_of_ending(str(summary.get("ended", ""))),
        "facts": _facts(run, summary, placed, len(paths)),
        "t": listed(seconds[kept], 3),
        "ego": {
            "x": listed(on_page[:, 0], 2),
            "y": listed(on_page[:, 1], 2),
            "yaw": listed(placed.yaw(_heading(state))[kept], 3),
            "speed": listed(speed[kept], 3),
        },
        "segments": state["segment"][kept].tolist(),
        "health": {
            health: spans(seconds, state["health"] == health) for health in ("degraded", "lost")
        },
        "standing": spans(seconds, state["standing"] > 0),
        "sigma": listed(columns(state, *_SIGMAS)[kept].T * _units()[:, None], 5),
        "truth": None
        if placed.truth is None
        else _truth(placed.truth, frame_ns[kept])
        | _true_objects(placed, frame_ns[kept], room.path_rows),
        "tracks": map_paths(paths, placed, frame_ns[kept], room.path_rows),
        "looked_for_objects": run.looked_for_objects,
        "objects": [row | {"view": pictures.views.get(row["id"])} for row in objects],
        "timing": _timing(run, frame_ns[kept]),
        "warnings": _warnings(summary),
        "pictures": _pictures(pictures, zero_ns),
        "settings": _settings(summary),
        "details": _details(summary),
    }


def run_names(folders: Sequence[Path]) -> list[str]:
    """What the runs are called: the last part of their paths, or as many as tell them apart."""
    whole = [folder.resolve().parts for folder in folders]
    names = [parts[-1] for parts in whole]
    for n in range(1, max(len(parts) for parts in whole) + 1):
        names = ["/".join(parts[-n:]) for parts in whole]
        if len(set(names)) == len(names):
            return names
    return names


def _start_ns(run: Run) -> int:
    if len(run.state) == 0:
        raise InputError.at(run.folder, "holds no poses", "give a run that has started")
    return int(run.state["timestamp_ns"][0])


def _summary(run: Run) -> dict[str, Any]:
    """`run.json`; a live recording may have none."""
    return run.summary if (run.folder / "run.json").is_file() else {}


def _tracks(run: Run) -> Rows:
    return run.tracks if (run.folder / "tracks.csv").is_file() else np.empty(0, np.dtype([]))


def _heading(state: Rows) -> FloatArray:
    """Heading (N,) of the camera's optical axis in the world, rad: where the rig looks."""
    return _axis_heading(columns(state, "qx", "qy", "qz", "qw"), _camera_axis(state))


def _camera_axis(state: Rows) -> FloatArray:
    """The left camera's optical axis (N, 3) in the IMU's frame."""
    x, y, z, w = columns(
        state, "imu_cam0_qx", "imu_cam0_qy", "imu_cam0_qz", "imu_cam0_qw"
    ).T  # fmt: skip
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _axis_heading(q: FloatArray, axis: FloatArray) -> FloatArray:
    """Heading (N,) of vectors (N, 3) turned by unit quaternions (N, 4), x y z w."""
    u, w = q[:, :3], q[:, 3:]
    turned = axis + 2.0 * np.cross(u, np.cross(u, axis) + w * axis)
    return np.asarray(np.arctan2(turned[:, 1], turned[:, 0]))


def _units() -> FloatArray:
    """Of rotation and position in plots: degrees and metres."""
    return np.array([*[np.degrees(1.0)] * 3, 1.0, 1.0, 1.0])


def _truth(metrics: EgoMetrics, grid_ns: IntArray) -> dict[str, Any]:
    """The true path, errors, their bounds and NEES, at the frames of the grid that have them."""
    series = metrics.series
    at = np.minimum(np.searchsorted(series.timestamp_ns, grid_ns), len(series.timestamp_ns) - 1)
    there = series.timestamp_ns[at] == grid_ns
    scale = _units()[None, :]
    errors = np.where(there[:, None], scale * series.errors[at], np.nan)
    bounds = np.where(there[:, None], scale * series.three_sigma[at], np.nan)
    squares = np.stack([series.nees[part] for part in _NEES_PARTS], axis=1)
    path = series.position_true[grid(len(series.position_true), len(grid_ns))]
    return {
        "x": listed(path[:, 0], 2),
        "y": listed(path[:, 1], 2),
        "errors": listed(errors.T, 4),
        "bounds": listed(bounds.T, 4),
        "nees": listed(np.where(there[:, None], squares[at], np.nan).T, 3),
        "nees_band": listed(np.array(chi_squared_bounds(3)), 3),
    }


def _true_objects(placed: Placed, grid_ns: IntArray, most_rows: int) -> dict[str, Any]:
    found = placed.true_objects
    return {"objects": [] if found is None else true_paths(found, grid_ns, most_rows)}


def _timing(run: Run, grid_ns: IntArray) -> dict[str, Any] | None:
    """Milliseconds of each stage at the grid's frames, and their median over the run."""
    if not (run.folder / "timing.csv").is_file() or len(run.timing) == 0:
        return None
    timing = run.timing
    names = [name for name in timing.dtype.names or () if name != "timestamp_ns"]
    at = np.minimum(np.searchsorted(timing["timestamp_ns"], grid_ns), len(timing) - 1)
    values = columns(timing, *names)
    used = [k for k in range(len(names)) if np.nansum(values[:, k]) > 0.0]
    total = np.nansum(values, axis=1)
    return {
        "stages": [_STAGES.get(names[k], names[k]) for k in used],
        "ms": listed(values[at][:, used].T, 2),
        "median": [number(_median(values[:, k]), 2) for k in used],
        "total": number(float(np.median(total)), 1),
        "slow": number(float(np.percentile(total, 95.0)), 1),
    }


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _warnings(summary: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "message": str(entry.get("message", "")),
            "count": int(entry.get("count", 1)),
            "remedy": remedy_of(str(entry.get("message", ""))),
        }
        for entry in summary.get("warnings", [])
    ]


def _pictures(pictures: Pictures, zero_ns: int) -> dict[str, list[Any]]:
    return {
        "t": [round(1e-9 * (stamp - zero_ns), 3) for stamp, _ in pictures.frames],
        "src": [uri for _, uri in pictures.frames],
    }


def _settings(summary: dict[str, Any]) -> list[dict[str, str]]:
    """The settings that differ from their defaults, with what they mean."""
    used = summary.get("settings", {})
    defaults = Settings().model_dump(mode="json")
    preset = (summary.get("preset") or {}).get("values", {})
    meaning = {key: text for key, _, _, text in describe_settings()}
    rows = []
    for section, values in used.items():
        for name, value in values.items() if isinstance(values, dict) else ():
            default = defaults.get(section, {}).get(name)
            key = f"{section}.{name}"
            if value != default:
                rows.append(
                    {
                        "key": key, "value": _shown(value), "default": _shown(default),
                        "from": "preset" if key in preset else "", "meaning": meaning.get(key, ""),
                    }
                )  # fmt: skip
    return rows


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_shown(v) for v in value) or "none"
    return (
        "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    )


def _facts(
    run: Run, summary: dict[str, Any], placed: Placed, n_objects: int
) -> list[dict[str, str]]:
    """The headline of a run: what, how much, how good."""
    state = run.state
    seconds = 1e-9 * float(state["timestamp_ns"][-1] - state["timestamp_ns"][0])
    steps = np.linalg.norm(np.diff(columns(state, "x", "y", "z"), axis=0), axis=1)
    steps = steps[np.diff(state["segment"]) == 0]
    tracking = 100.0 * float(np.mean(state["health"] == "tracking"))
    facts = {
        "frames": f"{len(state)}",
        "duration": f"{seconds:.1f} s",
        "path": f"{steps.sum():.1f} m",
        "tracking": f"{tracking:.1f} %" if tracking < 100.0 else "100 %",
        "objects": f"{n_objects}" if run.looked_for_objects else "not looked for",
    }
    if len(run.state) and summary.get("wall_seconds"):
        facts["frames/s"] = f"{len(state) / summary['wall_seconds']:.1f}"
    ate = None if placed.truth is None else placed.truth.ate.get("yaw")
    if ate is not None and placed.truth is not None:
        facts["ATE, position"] = f"{ate.translation.rmse:.3g} m"
        relative = placed.truth.distance_m
        if relative > 2.0:
            facts["ATE of the path"] = f"{100.0 * ate.translation.rmse / relative:.2g} %"
    return [{"name": name, "value": value} for name, value in facts.items()]


def _details(summary: dict[str, Any]) -> list[dict[str, str]]:
    """Input, options, versions and counts, for whoever wants to know exactly."""
    rows = []
    for part in ("input", "options", "imu_noise", "counts", "versions"):
        values = summary.get(part)
        for name, value in values.items() if isinstance(values, dict) else ():
            if value not in (None, 0):
                rows.append({"part": part, "name": str(name), "value": _shown(value)})
    return rows
