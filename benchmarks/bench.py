"""Speed of the odometry beside the floor (`floor.py`) and beside other programs.

    python benchmarks/bench.py [FOLDER ...] [--runs N]
    python benchmarks/bench.py [FOLDER ...] --against 'COMMAND {sequence}'
    python benchmarks/bench.py [FOLDER] --curve features|objects|size|clones
    python benchmarks/bench.py --curve length [--minutes 60]

Without folders: `euroc_mh01` and `street_traffic` of the test data ($OVMOT_DATA, else
../shared/data), and a street with traffic at 1280x560, which is simulated once. Images are decoded
into memory first. The tables are in Markdown, for BENCHMARK.md; docs/performance.md explains them.
"""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import bench_length
import ovmot
from bench_against import ProcessTimes, in_turn
from bench_curves import COLUMNS, CURVES, CurveOptions
from bench_inputs import Recording, default_cache, default_folders, in_memory
from bench_report import load, machine, spread, table
from bench_turns import Turns, take_turns

VARIANTS = {"with": (), "without": ("objects.enabled=false",)}
"""Settings by what the table says of the objects."""

SPEED = (
    "sequence", "image", "objects", "frames", "frames/s", "wall, ms", "CPU, ms",
    "frame: median / p95 / max, ms", "floor, ms", "x floor (least to greatest)", "CPU x floor's",
    "start, s", "x floor with start", "outside calls: of wall / of CPU, %",
    "calls a frame", "memory, MB",
)  # fmt: skip
AGAINST = ("sequence", "program", "wall, s", "CPU, s", "memory, MB", "wall / ovmot's")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    asked = parsed(arguments)
    ovmot.prepare_process()
    load_before = load()
    try:
        for text in tables(asked):
            print(text, end="\n\n", flush=True)
    except ovmot.OvmotError as error:
        raise SystemExit(f"bench: {error}") from None
    print(machine(load_before, load()))


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--runs", type=int, default=5, help="runs of each (default 5)")
    parser.add_argument("--against", metavar="COMMAND", help="another program; {sequence}, {out}")
    parser.add_argument("--curve", choices=[*CURVES, "length"], help="cost against one thing")
    parser.add_argument("--values", type=int, nargs="+", default=(), help="of the curve")
    parser.add_argument("--minutes", type=float, default=2.0, help="of the curve `length`")
    parser.add_argument("--cache", type=Path, default=default_cache(), help="of simulated streets")
    asked = parser.parse_args(arguments)
    if asked.runs < 1:
        parser.error("--runs: at least 1")
    return asked


def tables(asked: argparse.Namespace) -> list[str]:
    """What was asked for, measured; raises `OvmotError` where that cannot be done."""
    if asked.curve == "length":
        return [table(bench_length.COLUMNS, bench_length.against_length(asked.minutes))]
    folders = asked.folders or default_folders(asked.cache)
    if asked.curve is not None:
        last_real = next((f for f in folders if f.name == "street_traffic"), folders[0])
        options = CurveOptions(last_real, asked.cache, asked.runs, tuple(asked.values))
        label, rows = CURVES[asked.curve](options)
        return [table((label, *COLUMNS), rows)]
    if asked.against is not None:
        found = [against_rows(folder, asked.against, asked.runs) for folder in folders]
        return [table(AGAINST, [row for rows in found for row in rows])]
    measured = [in_own_process(folder, asked.runs) for folder in folders]
    speed_rows = [row for rows, _ in measured for row in rows]
    stage_rows = [row for _, rows in measured for row in rows]
    names = list(dict.fromkeys(name for row in stage_rows for name in row[1]))
    stages = [(*label, *(times.get(name, "") for name in names)) for label, times in stage_rows]
    heading = ("sequence", "objects", *(f"{name}, ms" for name in names))
    return [table(SPEED, speed_rows), table(heading, stages)]


Rows = tuple[list[tuple[str, ...]], list[tuple[tuple[str, str], dict[str, str]]]]
"""Rows of the table of speed, and of that of stages: the labels, and a cell for each stage."""


def in_own_process(folder: Path, runs: int) -> Rows:
    """`sequence_rows` in a process of its own: each sequence's memory is that of itself alone."""
    print(f"bench: {folder}", file=sys.stderr)
    with ProcessPoolExecutor(1, get_context("spawn"), ovmot.prepare_process) as pool:
        return pool.submit(sequence_rows, folder, runs).result()


def sequence_rows(folder: Path, runs: int) -> Rows:
    """One sequence with and without objects, and the floor, in turn."""
    recording = in_memory(folder)
    settings = {name: ovmot.load_settings(None, keys) for name, keys in VARIANTS.items()}
    turns = take_turns(recording, settings, runs, with_share=True)
    return (
        [_speed_row(recording, name, found) for name, found in turns.items()],
        [((recording.name, name), _stage_cells(found)) for name, found in turns.items()],
    )


def _speed_row(recording: Recording, objects: str, turns: Turns) -> tuple[str, ...]:
    wall, share, ratios = turns.median("wall_ms"), turns.share, turns.ratios
    memory = turns.median("peak_bytes") - recording.image_bytes
    return (
        recording.name, recording.size, objects, str(turns.runs[0].n_frames),
        f"{1e3 / wall:.1f}", f"{wall:.1f}", f"{turns.median('cpu_ms'):.1f}",
        spread(turns.frame_ms), f"{np.median(turns.floor_ms):.1f}",
        f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})",
        f"{np.median(turns.cpu_ratios):.2f}",
        f"{turns.median('start_s'):.2f}", f"{np.median(turns.whole_ratios):.2f}",
        "" if share is None else f"{100 * share.of_wall:.0f} / {100 * share.of_cpu:.0f}",
        "" if share is None else f"{share.calls_a_frame:.0f}", f"{1e-6 * memory:.0f}",
    )  # fmt: skip


def _stage_cells(turns: Turns) -> dict[str, str]:
    """Median, 95th percentile and maximum of each stage."""
    return {name: spread(milliseconds) for name, milliseconds in turns.stage_ms.items()}


def against_rows(folder: Path, command: str, runs: int) -> list[tuple[str, ...]]:
    """Medians of whole processes: ours, and the other program."""
    ours, theirs = in_turn(folder, command, runs)
    return [
        (folder.resolve().name, name, *_process_cells(times, ours))
        for name, times in (("ovmot run", ours), (command.split(maxsplit=1)[0], theirs))
    ]


def _process_cells(times: list[ProcessTimes], ours: list[ProcessTimes]) -> tuple[str, ...]:
    ratio = np.median([t.wall_s / o.wall_s for t, o in zip(times, ours, strict=True)])
    return (
        f"{np.median([t.wall_s for t in times]):.2f}",
        f"{np.median([t.cpu_s for t in times]):.2f}",
        f"{1e-6 * np.median([t.peak_bytes for t in times]):.0f}",
        f"{ratio:.2f}",
    )


if __name__ == "__main__":
    main()
