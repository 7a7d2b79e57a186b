"""Figures of docs/results.md, of a run on a simulated street.

python docs/figures/results.py
"""

from pathlib import Path
from typing import Any

import numpy as np

import ovmot
from common import BLUE, COLOURS, GREY, IMAGES, RED, figure, save, street
from ovmot.evaluation.matching import ComparedFrame

STAGES = ("match", "split", "correct", "objects", "predict", "forget", "start")


def main(folder: Path = IMAGES, **simulated: Any) -> list[Path]:
    """Draw the five figures; `simulated` are arguments of `ovmot.simulate`."""
    data, run = street("traffic", **({"seed": 41, "size": (640, 280)} | simulated))
    evaluation = ovmot.evaluate(run, data)
    return [
        _map(run, folder),
        _error(evaluation, folder),
        _speeds(run, evaluation.frames, folder),
        _points(data, run, folder),
        _timing(run, folder),
    ]


def seconds(run: ovmot.Run, stamps: Any) -> Any:
    """Stamps (N,) as seconds from the run's first frame."""
    return 1e-9 * (stamps - run.trajectory.timestamp_ns[0])


def tracks_of(run: ovmot.Run) -> list[tuple[int, Any]]:
    """Each confirmed track's id and rows, those seen longest first; at most as many as colours."""
    confirmed = run.tracks[run.tracks["state"] == "confirmed"]
    ids, counts = np.unique(confirmed["track_id"], return_counts=True)
    longest = ids[np.argsort(-counts, kind="stable")][: len(COLOURS)]
    return [(int(i), confirmed[confirmed["track_id"] == i]) for i in longest]


def _map(run: ovmot.Run, folder: Path) -> Path:
    made, axes = figure(7.0, 2.3)
    position = run.trajectory.T_world_imu[:, :3, 3]
    axes.plot(position[:, 0], position[:, 1], color="k", lw=2.0, label="the rig")
    axes.plot(*position[0, :2], "ko", ms=5)
    for (track_id, rows), colour in zip(tracks_of(run), COLOURS, strict=False):
        axes.plot(rows["x"], rows["y"], color=colour, lw=1.5, label=f"object {track_id}")
        axes.plot(rows["x"][-1], rows["y"][-1], "s", color=colour, ms=5)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return save(made, "results_map", folder)


def _error(evaluation: ovmot.Evaluation, folder: Path) -> Path:
    made, all_axes = figure(7.0, 4.0, rows=3)
    series = evaluation.ego.series
    time = 1e-9 * (series.timestamp_ns - series.timestamp_ns[0])
    for k, (axes, name) in enumerate(zip(all_axes, "xyz", strict=True)):
        error, band = 1e3 * series.errors[:, 3 + k], 1e3 * series.three_sigma[:, 3 + k]
        axes.fill_between(time, -band, band, color=GREY, alpha=0.3, lw=0)
        axes.plot(time, error, color=BLUE)
        axes.set_ylabel(f"{name} (mm)")
    all_axes[-1].set_xlabel("time (s)")
    return save(made, "results_error", folder)


def _speeds(run: ovmot.Run, frames: tuple[ComparedFrame, ...], folder: Path) -> Path:
    made, axes = figure(7.0, 3.0)
    for (track_id, rows), colour in zip(tracks_of(run), COLOURS, strict=False):
        time, speed = seconds(run, rows["timestamp_ns"]), np.hypot(rows["vx"], rows["vy"])
        sigma = np.hypot(rows["vx"] * rows["std_vx"], rows["vy"] * rows["std_vy"]) / speed
        axes.fill_between(time, speed - sigma, speed + sigma, color=colour, alpha=0.25, lw=0)
        axes.plot(time, speed, color=colour, label=f"object {track_id}")
        axes.plot(*_true_speed(run, frames, track_id), color=colour, ls=":", lw=1.2)
    axes.plot([], [], "k:", lw=1.2, label="true")
    axes.set(xlabel="time (s)", ylabel="speed (m/s)", ylim=(0.0, None))
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return save(made, "results_speeds", folder)


def _true_speed(run: ovmot.Run, frames: tuple[ComparedFrame, ...], track_id: int) -> Any:
    """Times and speeds (2, N) of the object that a track is on; NaN where it is on none."""
    rows = []
    for frame in frames:
        i, j = frame.pairs.T
        of_track = i[frame.tracks.track_id[j] == track_id]
        true = np.linalg.norm(frame.objects.velocity[of_track], axis=1)
        rows.append((seconds(run, frame.objects.timestamp_ns), true[0] if len(true) else np.nan))
    return np.transpose(rows)


def _points(data: Path, run: ovmot.Run, folder: Path) -> Path:
    points = run.points
    stamps, counts = np.unique(
        points["timestamp_ns"][points["label"] == "dynamic"], return_counts=True
    )
    stamp = int(stamps[np.argmax(counts)])
    now = points[points["timestamp_ns"] == stamp]
    made, axes = figure(7.0, 3.2)
    axes.imshow(left_image(data, stamp), cmap="gray", vmin=0, vmax=255)
    for label, colour in (("static", BLUE), ("unknown", GREY), ("dynamic", RED)):
        rows = now[now["label"] == label]
        axes.plot(rows["u"], rows["v"], ".", ms=4, color=colour, label=f"{label}: {len(rows)}")
    axes.grid(False)
    axes.set_axis_off()
    axes.legend(fontsize=8, loc="upper right")
    return save(made, "results_points", folder, "jpg")


def left_image(data: Path, stamp: int) -> Any:
    """The left grey image of a simulated folder at a stamp."""
    for event in ovmot.open(data):
        if isinstance(event, ovmot.StereoFrame) and event.timestamp_ns == stamp:
            return event.left
    raise ValueError(f"{data}: no frame at {stamp}")


def _timing(run: ovmot.Run, folder: Path) -> Path:
    made, axes = figure(7.0, 2.8)
    timing = run.timing
    named = [name for name in STAGES if name in (timing.dtype.names or ())]
    values = np.nan_to_num(np.array([timing[name] for name in named]))
    axes.stackplot(
        seconds(run, timing["timestamp_ns"]), values, labels=named, colors=[*COLOURS, GREY],
        lw=0,
    )  # fmt: skip
    typical = np.percentile(values.sum(axis=0), 90)
    axes.set(xlabel="time (s)", ylabel="ms", ylim=(0.0, 1.5 * typical))
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return save(made, "results_timing", folder)


if __name__ == "__main__":
    ovmot.prepare_process()
    main()
