"""The trajectory from above, with the true objects and the run's tracks."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ovmot.evaluation.ego import EgoSeries
from ovmot.evaluation.matching import ComparedFrame
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray

_ESTIMATE = "#d55e00"
_PALETTE = ("#0072b2", "#009e73", "#56b4e9", "#cc79a7", "#e69f00", "#8c6bb1", "#666633")
"""Of tracks: none is like the estimated path's, nor are two alike to the colour-blind (the first
five, and the path's: M. Okabe, K. Ito, "Color Universal Design", 2008)."""
_NAME_SHARE = 0.035
"""Names nearer to another one, as a share of the map's size, are left out: see `_Names`."""


def map_figure(series: EgoSeries, frames: Sequence[ComparedFrame] = ()) -> Figure:
    """True and estimated path in the truth's world, metres; tracks coloured by their id.

    Objects have their number, tracks `#` and their id, where there is room for it.
    Tracks are carried into the truth's world by the true pose of their frame, as they are compared.
    """
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    panel = figure.subplots()
    objects, tracks = _object_paths(frames), _track_paths(frames)
    paths = [*objects.values(), *tracks.values(), series.position_true[:, :2]]
    names = _Names(panel, float(np.ptp(np.concatenate(paths), axis=0).max()))
    for number, (object_id, path) in enumerate(sorted(objects.items())):
        label = "true objects that move" if number == 0 else None
        panel.plot(*path.T, color="0.6", linewidth=4.0, alpha=0.5, solid_capstyle="round",
                   label=label)  # fmt: skip
        names.write(path[0], f"{object_id}", "0.4")
    for number, (track_id, path) in enumerate(sorted(tracks.items())):
        color, label = _PALETTE[track_id % len(_PALETTE)], "tracks (#)" if number == 0 else None
        panel.plot(*path.T, color=color, linewidth=1.2, marker=".", markersize=3.0, label=label)
        names.write(path[-1], f"#{track_id}", color)
    panel.plot(*series.position_true[:, :2].T, color="black", linewidth=2.2, label="true path")
    panel.plot(*series.position_aligned[:, :2].T, color=_ESTIMATE, linewidth=1.3,
               label="estimated path (yaw and position aligned)")  # fmt: skip
    panel.plot(*series.position_true[0, :2], color="black", marker="o", linestyle="none",
               label="start")  # fmt: skip
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("x [m]")
    panel.set_ylabel("y [m]")
    panel.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=5, frameon=False)
    return figure


def _object_paths(frames: Sequence[ComparedFrame]) -> dict[int, FloatArray]:
    """Paths (N, 2) of the objects that are seen moving, where they have to be found."""
    points: dict[int, list[FloatArray]] = {}
    for frame in frames:
        for i in np.flatnonzero(frame.needed):
            object_id = int(frame.objects.object_id[i])
            points.setdefault(object_id, []).append(frame.objects.center[i, :2])
    return {name: np.array(path) for name, path in points.items()}


def _track_paths(frames: Sequence[ComparedFrame]) -> dict[int, FloatArray]:
    """Paths (N, 2) of the tracks, in the truth's world."""
    points: dict[int, list[FloatArray]] = {}
    for frame in frames:
        T_true_run = frame.T_true @ se3.inverse(frame.T_run)
        moved = se3.apply(T_true_run, frame.tracks.position)
        for track_id, position in zip(frame.tracks.track_id.tolist(), moved, strict=True):
            points.setdefault(track_id, []).append(position[:2])
    return {name: np.array(path) for name, path in points.items()}


class _Names:
    """Writes names beside points, none on another one: what has no room is left out."""

    def __init__(self, panel: Axes, size: float) -> None:
        self._panel = panel
        self._apart = _NAME_SHARE * size
        self._taken: list[FloatArray] = []

    def write(self, at: FloatArray, text: str, color: str) -> None:
        """Write a name beside a place (2,) of the map, unless another one is near."""
        # a name is wider than it is high
        if any(abs(at[0] - x) < 1.5 * self._apart and abs(at[1] - y) < self._apart
               for x, y in self._taken):  # fmt: skip
            return
        self._taken.append(at)
        self._panel.annotate(
            text, (float(at[0]), float(at[1])), textcoords="offset points", xytext=(4, 4),
            fontsize=8, color=color,
        )  # fmt: skip
