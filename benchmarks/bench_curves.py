"""Cost against one thing at a time: features, moving objects, image size, clones."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

import ovmot
from bench_inputs import TRAFFIC_SIZE, Recording, in_memory, simulated_street
from bench_report import spread
from bench_turns import Turns, take_turns

COLUMNS = (
    "features in a frame", "confirmed objects in a frame", "frames/s", "wall, ms", "x floor",
    "CPU x floor's", "frame: median / p95 / max, ms", "memory, MB",
)  # fmt: skip
MAX_FEATURES = (50, 100, 150, 200, 250, 350, 500, 800)
MAX_CLONES = (5, 8, 11, 15, 20, 30)
BODIES = (0, 1, 5, 10, 20)
SHARES_OF_SIZE = (0.25, 0.5, 0.75, 1.0)
_BODIES_SIZE, _BODIES_S = (640, 280), 10.0
_ROW, _FIRST_ROW_M, _ROWS_APART_M, _WALKERS_APART_M = 5, 8.0, 3.0, 1.9
_RIG_M, _WALKERS_MPS = 5.0, 1.3


@dataclass(frozen=True, slots=True)
class CurveOptions:
    """On what a curve is measured: a sequence where the images stay the same, else streets kept in
    `cache`; `values` in place of the usual ones."""

    folder: Path
    cache: Path
    runs: int
    values: tuple[int, ...] = ()


Row = tuple[str, ...]


def against_features(options: CurveOptions) -> tuple[str, list[Row]]:
    """The setting `tracker.max_features`; other settings ask for further features."""
    return _against_setting(options, "tracker.max_features", MAX_FEATURES)


def against_clones(options: CurveOptions) -> tuple[str, list[Row]]:
    """The setting `filter.max_clones`."""
    return _against_setting(options, "filter.max_clones", MAX_CLONES)


def against_objects(options: CurveOptions) -> tuple[str, list[Row]]:
    """Walkers ahead of a rig that goes as they do: all of them stay in view."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.values or BODIES:
            scene = Path(folder) / f"walkers_{count}.yaml"
            scene.write_text(yaml.safe_dump(walkers(count)), encoding="utf-8")
            street = simulated_street(options.cache, str(scene), _BODIES_SIZE, _BODIES_S)
            rows.append(_measured(str(count), in_memory(street), options.runs))
    return "bodies in view", rows


def against_size(options: CurveOptions) -> tuple[str, list[Row]]:
    """Image size: the scene `traffic`; the values are widths."""
    width, height = TRAFFIC_SIZE
    rows = []
    for wide in options.values or [round(share * width) for share in SHARES_OF_SIZE]:
        size = (wide, round(wide * height / width))
        recording = in_memory(simulated_street(options.cache, "traffic", size))
        rows.append(_measured(recording.size, recording, options.runs))
    return "image", rows


CURVES: Mapping[str, Callable[[CurveOptions], tuple[str, list[Row]]]] = {
    "features": against_features,
    "objects": against_objects,
    "size": against_size,
    "clones": against_clones,
}


def walkers(count: int) -> dict[str, object]:
    """A scene of walkers in rows of five, the next row behind the gaps of the one before it."""
    speed = [[1.0, 0.0], [2.0, _WALKERS_MPS]]
    along = []
    for i in range(count):
        row, place = divmod(i, _ROW)
        sideways = (place - 0.5 * (_ROW - 1) + 0.5 * (row % 2) - 0.25) * _WALKERS_APART_M
        ahead = _RIG_M + _FIRST_ROW_M + _ROWS_APART_M * row
        along.append({"kind": "walker", "start_m": ahead, "offset_m": sideways, "speed": speed})
    return {
        "duration_s": _BODIES_S,
        "drive": {"start_m": _RIG_M, "offset_m": 0.0, "speed": speed},
        "along": along,
        "jitter": {"start_m": 0.3, "speed": 0.0},
    }


def _against_setting(
    options: CurveOptions, key: str, usual: tuple[int, ...]
) -> tuple[str, list[Row]]:
    variants = {
        str(value): ovmot.load_settings(None, [f"{key}={value}"])
        for value in options.values or usual
    }
    recording = in_memory(options.folder)
    turns = take_turns(recording, variants, options.runs)
    rows = [_row(value, recording, found) for value, found in turns.items()]
    return f"`{key}` on {recording.name}", rows


def _measured(label: str, recording: Recording, runs: int) -> Row:
    return _row(label, recording, take_turns(recording, {label: ovmot.Settings()}, runs)[label])


def _row(label: str, recording: Recording, turns: Turns) -> Row:
    wall = turns.median("wall_ms")
    memory = turns.median("peak_bytes") - recording.image_bytes
    return (
        label, f"{turns.median('points'):.0f}", f"{turns.median('objects'):.1f}",
        f"{1e3 / wall:.1f}", f"{wall:.1f}", f"{np.median(turns.ratios):.2f}",
        f"{np.median(turns.cpu_ratios):.2f}", spread(turns.frame_ms), f"{1e-6 * memory:.0f}",
    )  # fmt: skip
