"""Figures of docs/moving-objects.md and docs/algorithm/objects.md.

What is found, how late, how fast it is taken to be, and what becomes of a track that is hidden.

python docs/figures/objects.py

Three streets of each of the scenes traffic, jam and crossing, and one of the scene bus.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import ovmot
from common import BLUE, COLOURS, GREY, IMAGES, ORANGE, figure, save, street
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria
from ovmot.evaluation.object_errors import detection_latency
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray

SCENES, SEEDS = ("traffic", "jam", "crossing"), (41, 42, 43)
BINS = np.arange(0.0, 61.0, 10.0)
"""Edges of the distances, m."""
NEAR_M = 2.5
"""Within this a track is on an object, as for `ovmot evaluate`."""


def main(
    folder: Path = IMAGES, scenes: Sequence[str] = SCENES, seeds: Sequence[int] = SEEDS,
    **simulated: Any,
) -> list[Path]:  # fmt: skip
    """Draw the figures; `simulated` are further arguments of `ovmot.simulate`."""
    wide = ObjectCriteria(max_range_m=float(BINS[-1]))
    runs: dict[str, list[tuple[ComparedFrame, ...]]] = {}
    for scene in scenes:
        for seed in seeds:
            data, run = street(scene, **({"seed": seed, "size": (640, 280)} | simulated))
            runs.setdefault(scene, []).append(ovmot.evaluate(run, data, wide).frames)
    data, run = street("bus", **({"seed": 21, "size": (640, 280)} | simulated))
    hidden = _hidden(ovmot.evaluate(run, data, wide).frames, folder)
    return [_by_distance(runs, folder), _latency(runs, folder), hidden]


def distances(frame: ComparedFrame) -> FloatArray:
    """Distance (N,) of each true object from the rig, m."""
    away = frame.objects.center[:, :2] - frame.T_true[:2, 3]
    return np.asarray(np.linalg.norm(away, axis=1))


def _by_distance(runs: dict[str, list[tuple[ComparedFrame, ...]]], folder: Path) -> Path:
    made, (left, right) = figure(7.5, 3.0, columns=2)
    for (scene, sequences), colour in zip(runs.items(), COLOURS, strict=False):
        frames = [frame for sequence in sequences for frame in sequence]
        needed = np.concatenate([distances(f)[f.needed] for f in frames])
        found = np.concatenate([distances(f)[f.pairs[:, 0]] for f in frames])
        counts, hits = np.histogram(needed, BINS)[0], np.histogram(found, BINS)[0]
        enough = counts >= 20
        middles = 0.5 * (BINS[:-1] + BINS[1:])
        left.plot(middles[enough], hits[enough] / counts[enough], "o-", color=colour, label=scene)
        errors = np.concatenate([_velocity_errors(f) for f in frames])
        bins = np.digitize(found, BINS) - 1
        shown = [k for k in range(len(middles)) if np.count_nonzero(bins == k) >= 20]
        for percent, style in ((50, "o-"), (90, "o:")):
            values = [np.percentile(errors[bins == k], percent) for k in shown]
            right.plot(middles[shown], values, style, color=colour)
    right.plot([], [], "k-", label="median")
    right.plot([], [], "k:", label="90 %")
    left.set(xlabel="distance (m)", ylabel="share of the frames found", ylim=(0.0, 1.05))
    right.set(xlabel="distance (m)", ylabel="error of the velocity (m/s)", yscale="log")
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    return save(made, "objects_distance", folder)


def _velocity_errors(frame: ComparedFrame) -> FloatArray:
    """Length (M,) of the velocity's error of each object found, level, m/s."""
    i, j = frame.pairs.T
    R_true_run = frame.T_true[:3, :3] @ frame.T_run[:3, :3].T
    velocity = frame.tracks.velocity[j] @ R_true_run.T
    return np.asarray(np.linalg.norm((velocity - frame.objects.velocity[i])[:, :2], axis=1))


def _latency(runs: dict[str, list[tuple[ComparedFrame, ...]]], folder: Path) -> Path:
    made, axes = figure(6.0, 2.8)
    late = [detection_latency(frames) for sequences in runs.values() for frames in sequences]
    seconds = np.sort(np.concatenate([one.seconds for one in late]))
    never = sum(one.never for one in late)
    share = np.arange(1, len(seconds) + 1) / (len(seconds) + never)
    last = share[-1] if len(share) else 0.0
    axes.step([0.0, *seconds, 5.0], [0.0, *share, last], where="post", color=BLUE)
    axes.axhline(1.0, color=GREY, lw=0.8, ls=":")
    axes.set(
        xlabel="time since it has to be found (s)", ylabel="share of the objects",
        xlim=(-0.05, 4.0), ylim=(0.0, 1.05),
        title=f"{len(seconds) + never} objects, {never} never found",
    )  # fmt: skip
    axes.axvline(0.5, color=ORANGE, lw=0.8, ls=":")
    return save(made, "objects_latency", folder)


def _hidden(frames: Sequence[ComparedFrame], folder: Path) -> Path:
    """Where an object is across the view that was found and then hidden, and its tracks."""
    made, axes = figure(7.0, 2.8)
    seconds = 1e-9 * np.array([f.objects.timestamp_ns for f in frames])
    seconds -= seconds[0]
    ids = np.unique(np.concatenate([f.objects.object_id for f in frames])).tolist()
    chosen = max(ids, key=lambda k: _longest_gap(frames, k))
    at = [np.flatnonzero(f.objects.object_id == chosen) for f in frames]
    y = np.array([_across(f, k) for f, k in zip(frames, at, strict=True)])
    seen = _is_seen(frames, chosen)
    axes.plot(seconds, np.where(seen, y, np.nan), "-", color=GREY, label="truth")
    axes.plot(seconds, np.where(seen, np.nan, y), ":", color=GREY, label="truth, hidden")
    tracks: dict[int, list[tuple[float, float, float]]] = {}
    for second, frame, k in zip(seconds, frames, at, strict=True):
        for row in np.flatnonzero((frame.distance[k] < NEAR_M).any(axis=0)):
            here = _in_rig(frame.T_run, frame.tracks.position[row])[1]
            of_track = tracks.setdefault(int(frame.tracks.track_id[row]), [])
            of_track.append((second, here, frame.tracks.std[row, 1]))
    for colour, (track_id, values) in zip(COLOURS, sorted(tracks.items()), strict=False):
        t, here, sigma = np.array(values).T
        axes.errorbar(
            t, here, sigma, fmt=".", ms=4, lw=0.8, color=colour, label=f"track {track_id}"
        )
    if tracks:
        t, here, _ = np.array([row for rows in tracks.values() for row in rows]).T
        axes.set(xlim=(t.min() - 1.0, t.max() + 1.0), ylim=(here.min() - 5.0, here.max() + 5.0))
    axes.set(xlabel="time (s)", ylabel="to the left of the rig (m)")
    axes.legend(fontsize=8)
    return save(made, "objects_hidden", folder)


def _is_seen(frames: Sequence[ComparedFrame], object_id: int) -> BoolArray:
    """In which frames (N,) an object has visible pixels."""
    return np.array([
        bool((f.objects.visible_px[f.objects.object_id == object_id] > 0).any()) for f in frames
    ])  # fmt: skip


def _longest_gap(frames: Sequence[ComparedFrame], object_id: int) -> int:
    """Most frames in a row in which an object was not seen, after it was found and before it was
    seen again."""
    found = [object_id in f.objects.object_id[f.pairs[:, 0]] for f in frames]
    rows = np.flatnonzero(_is_seen(frames, object_id))
    if not any(found):
        return 0
    return int(np.diff(rows[rows >= found.index(True)]).max(initial=0))


def _in_rig(T_world_rig: FloatArray, p: FloatArray) -> FloatArray:
    """A point (3,) in the rig's frame."""
    return np.asarray(T_world_rig[:3, :3].T @ (p - T_world_rig[:3, 3]))


def _across(frame: ComparedFrame, row: IntArray) -> float:
    """How far to the left of the rig a true object is, NaN where there is none."""
    return float(_in_rig(frame.T_true, frame.objects.center[row[0]])[1]) if len(row) else np.nan


if __name__ == "__main__":
    ovmot.prepare_process()
    main()
