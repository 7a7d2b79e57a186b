"""Figures of docs/algorithm/index.md: the window, stereo depth, the epipolar gate, motion tests.

python docs/figures/algorithm.py
"""

from pathlib import Path
from typing import Any

import numpy as np

import ovmot
from common import BLUE, GREEN, GREY, IMAGES, ORANGE, RED, figure, save, street
from ovmot.geometry.arrays import FloatArray
from ovmot.physics import PIXEL_SIGMA, gate
from results import left_image
from rig import depth_sigma

BASELINE_M, FOCAL_PX = 0.475, 408.0
"""The rig of the simulated streets at 640x280: KAIST's, at half its size."""


def main(folder: Path = IMAGES, **simulated: Any) -> list[Path]:
    """Draw all figures; `simulated` are arguments of `ovmot.simulate`."""
    data, run = street("traffic", **({"seed": 41, "size": (640, 280)} | simulated))
    return [_window(folder), _epipolar(data, run, folder), _depth(folder), _motion(folder)]


def _window(folder: Path) -> Path:
    """The state of the filter: clones, an MSCKF feature, a SLAM feature, a dynamic one."""
    made, axes = figure(7.0, 2.6)
    x = np.linspace(0.0, 8.0, 9)
    y = 0.15 * np.sin(0.6 * x)
    axes.plot(x, y, "-", color=GREY, lw=0.8)
    axes.plot(x[:-1], y[:-1], "^", color="k", ms=8, label="clone (pose of a past frame)")
    axes.plot(x[-1:], y[-1:], "^", color=BLUE, ms=11, label="IMU state: pose, velocity, biases")
    seen = {
        "SLAM feature (in the state)": ((6.6, 1.9), range(1, 9), BLUE, "s"),
        "MSCKF feature, track ended: one update": ((2.8, 1.6), range(6), GREEN, "o"),
        "dynamic: no update uses it": ((4.6, -1.3), range(4, 9), RED, "x"),
    }
    for label, (point, clones, colour, mark) in seen.items():
        for k in clones:
            drift = 0.25 * (k - 6) if mark == "x" else 0.0
            axes.plot([x[k], point[0] + drift], [y[k], point[1]], color=colour, lw=0.5, alpha=0.7)
            if mark == "x":
                axes.plot(point[0] + drift, point[1], mark, color=colour, ms=6)
        axes.plot(*point, mark, color=colour, ms=8, label=label)
    axes.annotate("marginalized next", (x[0], y[0] - 0.1), (x[0] - 0.3, -1.3), fontsize=8,
                  arrowprops={"arrowstyle": "->", "lw": 0.7})  # fmt: skip
    axes.set_axis_off()
    axes.set(ylim=(-1.7, 2.3))
    axes.legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return save(made, "algorithm_window", folder)


def _epipolar(data: Path, run: ovmot.Run, folder: Path) -> Path:
    """Matches of one frame, and the distances of all matches from their epipolar lines."""
    made, (left, right) = figure(8.0, 2.5, columns=2)
    matches = run.stereo
    refused = matches[matches["accepted"] == 0]
    stamps, counts = np.unique(refused["timestamp_ns"], return_counts=True)
    stamp = int(stamps[np.argmax(counts)]) if len(stamps) else int(matches["timestamp_ns"][0])
    now = matches[matches["timestamp_ns"] == stamp]
    left.imshow(left_image(data, stamp), cmap="gray", vmin=0, vmax=255)
    for accepted, colour in ((1, BLUE), (0, RED)):
        rows = now[now["accepted"] == accepted]
        left.plot(rows["u"], rows["v"], ".", color=colour, ms=3)
    left.set_axis_off()
    left.set_title("accepted blue, refused red", fontsize=9)
    bins = np.geomspace(1e-3, 30.0, 60)
    for accepted, colour in ((1, BLUE), (0, RED)):
        rows = matches[matches["accepted"] == accepted]
        right.hist(np.clip(rows["distance_px"], 1e-3, 30.0), bins, color=colour)
    right.axvline(ovmot.Settings().epipolar.threshold_px, color="k", lw=0.8, ls=":")
    right.set(xscale="log", yscale="log", xlabel="distance from the line (px)", ylabel="matches")
    return save(made, "algorithm_epipolar", folder, "jpg")


def _depth(folder: Path) -> Path:
    """One-sigma ellipses of stereo points, from above."""
    made, axes = figure(7.0, 2.6)
    circle = np.linspace(0.0, 2.0 * np.pi, 60)
    for depth in (10.0, 20.0, 30.0, 40.0):
        for bearing in (-0.2, 0.0, 0.2):
            along = float(depth_sigma(np.array(depth), BASELINE_M, FOCAL_PX))
            across = depth * PIXEL_SIGMA / FOCAL_PX
            shape = np.stack([along * np.cos(circle), across * np.sin(circle)])
            turn = np.array(
                [[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]]
            )
            where = depth * np.array([np.cos(bearing), np.sin(bearing)])
            axes.plot(*(turn @ shape + where[:, None]), color=BLUE, lw=1.0)
    axes.plot(0.0, 0.0, "k^", ms=8)
    axes.set(xlabel="ahead (m)", ylabel="left (m)", aspect="equal", xlim=(-1.0, 46.0))
    return save(made, "algorithm_depth", folder)


def smallest_speed(depth: FloatArray, span: float, along_ray: bool) -> FloatArray:
    """Speed (N,) at which a point at depths (N,) is rejected as static after `span` seconds, m/s.

    Two independent stereo positions differ by √2 of their sigma; the gate is that of the covariance
    test, at its default probability of a false alarm.
    """
    sigma = (
        depth_sigma(depth, BASELINE_M, FOCAL_PX) if along_ray else depth * PIXEL_SIGMA / FOCAL_PX
    )
    limit = np.sqrt(gate(4, 1.0 - ovmot.Settings().segmentation.false_alarm))
    forgiven = ovmot.Settings().segmentation.forgiven_speed_mps
    return np.asarray(limit * np.hypot(np.sqrt(2.0) * sigma / span, forgiven))


def _motion(folder: Path) -> Path:
    """Which speeds show, by distance, direction and how far the comparison looks back."""
    made, axes = figure(7.0, 2.8)
    depth = np.linspace(3.0, 50.0, 60)
    for span, colour in ((0.1, RED), (0.4, ORANGE), (1.5, GREEN)):
        for along, style in ((False, "-"), (True, ":")):
            axes.semilogy(
                depth, smallest_speed(depth, span, along), style, color=colour,
                label=f"after {span} s, {'along' if along else 'across'} the ray",
            )  # fmt: skip
    for speed, name in ((1.3, "walker"), (13.9, "50 km/h")):
        axes.axhline(speed, color=GREY, lw=0.8)
        axes.text(50.5, speed, name, fontsize=8, va="center")
    axes.set(
        xlabel="distance (m)", ylabel="speed that shows (m/s)", ylim=(0.3, 300.0), xlim=(0.0, 50.0)
    )
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.1, 0.5))
    return save(made, "algorithm_motion", folder)


if __name__ == "__main__":
    ovmot.prepare_process()
    main()
