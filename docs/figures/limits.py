"""Figures of docs/limits.md: what is missed and what is wrongly found, in pictures.

python docs/figures/limits.py
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import ovmot
from common import BLUE, GREEN, GREY, IMAGES, RED, figure, save, street
from ovmot.evaluation.matching import ComparedFrame
from ovmot.geometry.arrays import IntArray
from ovmot.sim.faults import InjectedFault, Span, with_faults
from results import left_image

SEED = 41


def main(folder: Path = IMAGES, **simulated: Any) -> list[Path]:
    """Draw all figures; `simulated` are arguments of `ovmot.simulate`."""
    given: dict[str, Any] = {"seed": SEED, "size": (640, 280)} | simulated
    return [
        _outlines("traffic", _missed, "limits_missed", folder, given),
        _outlines("jam", _found, "limits_jam", folder, given),
        _dark(folder, given),
        _blind(folder, {"size": given["size"]} | simulated),
    ]


def _missed(frame: ComparedFrame) -> IntArray:
    """Rows of the objects that have to be found and are not."""
    needed = np.flatnonzero(frame.needed)
    return needed[~np.isin(needed, frame.pairs[:, 0])]


def _found(frame: ComparedFrame) -> IntArray:
    return frame.pairs[:, 0]


def _outlines(
    scene: str,
    wanted: Callable[[ComparedFrame], IntArray],
    name: str,
    folder: Path,
    given: dict[str, Any],
) -> Path:
    """The frame with most of the wanted objects: found ones outlined green, missed ones red."""
    data, run = street(scene, **given)
    frames = [frame for frame in ovmot.evaluate(run, data).frames if frame.objects.timestamp_ns]
    frame = max(frames, key=lambda f: len(wanted(f)))
    stamp = frame.objects.timestamp_ns
    ids = cv2.imread(str(data / "truth" / f"{stamp}.png"), cv2.IMREAD_UNCHANGED)
    made, axes = figure(7.0, 3.2)
    axes.imshow(left_image(data, stamp), cmap="gray", vmin=0, vmax=255)
    for rows, colour in ((_found(frame), GREEN), (_missed(frame), RED)):
        for object_id in frame.objects.object_id[rows].tolist():
            axes.contour(ids == object_id, levels=[0.5], colors=[colour], linewidths=1.5)
    axes.set_axis_off()
    return save(made, name, folder, "jpg")


def _dark(folder: Path, given: dict[str, Any]) -> Path:
    """The same street by day and at night, with the features of one frame by their labels."""
    made, both = figure(7.5, 2.0, columns=2)
    for axes, scene in zip(both, ("traffic", "night"), strict=True):
        data, run = street(scene, **given)
        points = run.points
        stamps = np.unique(points["timestamp_ns"])
        stamp = int(stamps[len(stamps) // 3])
        now = points[points["timestamp_ns"] == stamp]
        axes.imshow(left_image(data, stamp), cmap="gray", vmin=0, vmax=255)
        for label, colour in (("static", BLUE), ("unknown", GREY), ("dynamic", RED)):
            rows = now[now["label"] == label]
            axes.plot(rows["u"], rows["v"], ".", ms=2.5, color=colour)
        known = int(np.count_nonzero(now["label"] != "unknown"))
        axes.set_title(f"{scene}: {known} of {len(now)} features are judged", fontsize=9)
        axes.set_axis_off()
    return save(made, "limits_dark", folder, "jpg")


def _blind(folder: Path, given: dict[str, Any]) -> Path:
    """The position's error and its band where both cameras show nothing for a while."""
    data, _ = street("demo", **given)
    sequence = ovmot.open(data)
    start, length = sequence.frame_ns[0], np.ptp(sequence.frame_ns)
    begin, end = int(start + 0.4 * length), int(start + 0.7 * length)
    fault = InjectedFault("black_images", Span(begin, end))
    out = data.parent / "blind"
    options = ovmot.RunOptions(out, force=True)
    ovmot.run_sequence(with_faults(sequence, fault), ovmot.Settings(), options)
    series = ovmot.evaluate(out, data).ego.series
    time = 1e-9 * (series.timestamp_ns - start)
    made, axes = figure(7.0, 2.6)
    error = np.linalg.norm(series.errors[:, 3:], axis=1)
    band = np.linalg.norm(series.three_sigma[:, 3:], axis=1)
    axes.fill_between(time, 0.0, band, color=GREY, alpha=0.3, lw=0, label="3 sigma")
    axes.plot(time, error, color=BLUE, label="error of the position")
    state = ovmot.Run(out).state
    since = 1e-9 * (state["timestamp_ns"] - start)
    degraded = state["health"] != "tracking"
    axes.plot(since[degraded], np.zeros(degraded.sum()), "|", color=RED, ms=10, label="degraded")
    dark = 1e-9 * (begin - start), 1e-9 * (end - start)
    axes.axvspan(*dark, color="k", alpha=0.08, lw=0, label="black images")
    axes.set(xlabel="time (s)", ylabel="m")
    axes.legend(fontsize=8)
    return save(made, "limits_blind", folder)


if __name__ == "__main__":
    ovmot.prepare_process()
    main()
