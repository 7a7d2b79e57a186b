"""Speed of the pipeline: frames per second and milliseconds per stage, decoding apart.

    python benchmarks/bench.py [FOLDER ...] [--runs N]

Without folders: `euroc_mh01` and `street_traffic` of the test data ($OVMOT_DATA, else
../shared/data). Each sequence is decoded into memory first, then run N times; the median run is
printed. What is written to disk by `ovmot run` is not part of it.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import ovmot

DEFAULT_SEQUENCES = ("euroc_mh01", "street_traffic")


def main() -> None:
    """Measure and print one table."""
    arguments = parse_arguments()
    ovmot.prepare_process()
    table = Table(title="milliseconds a frame (median run)")
    for column in ("sequence", "image", "frames", "decode", "stages", "all stages", "frames/s"):
        table.add_column(column)
    for folder in arguments.folders:
        table.add_row(*measure(ovmot.open(folder), arguments.runs))
    Console().print(table)


def parse_arguments() -> argparse.Namespace:
    """Folders and number of runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    if not arguments.folders:
        here = Path(__file__).resolve().parent.parent
        data = Path(os.environ.get("OVMOT_DATA", here.parent / "shared" / "data"))
        arguments.folders = [data / name for name in DEFAULT_SEQUENCES if (data / name).is_dir()]
    if not arguments.folders:
        raise SystemExit("bench: no sequence found; give a folder, or set OVMOT_DATA")
    return arguments


def measure(sequence: ovmot.RecordedSequence, runs: int) -> tuple[str, ...]:
    """One row of the table."""
    decoding = time.perf_counter()
    stream = list(sequence)
    decoding = time.perf_counter() - decoding
    frames = sum(isinstance(event, ovmot.StereoFrame) for event in stream)
    results = sorted((run_once(sequence, stream) for _ in range(runs)), key=lambda r: r[0])
    seconds, stages = results[len(results) // 2]
    camera = sequence.rig.cam0
    listed = "  ".join(f"{name} {ms:.1f}" for name, ms in stages.items() if ms >= 0.05)
    return (
        sequence.root.name,
        f"{camera.width}x{camera.height}",
        str(frames),
        f"{1e3 * decoding / frames:.1f}",
        listed,
        f"{1e3 * seconds / frames:.1f}",
        f"{frames / seconds:.1f}",
    )


def run_once(
    sequence: ovmot.RecordedSequence, stream: list[ovmot.Event]
) -> tuple[float, dict[str, float]]:
    """Wall seconds of feeding everything, and the mean milliseconds of each stage."""
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise)
    spent: dict[str, list[float]] = {}
    begin = time.perf_counter()
    for event in stream:
        for result in odometry.add(event):
            for name, milliseconds in result.milliseconds.items():
                spent.setdefault(name, []).append(milliseconds)
    seconds = time.perf_counter() - begin
    odometry.finish()
    if not spent:
        raise ovmot.InputError(f"{sequence.root}: never started: {odometry.not_started_because}")
    n_results = max(len(values) for values in spent.values())
    return seconds, {name: float(np.sum(v)) / n_results for name, v in spent.items()}


if __name__ == "__main__":
    main()
