"""Figures of the ego motion's errors, without a window or global state."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from ovmot.errors import OvmotError
from ovmot.evaluation.consistency import chi_squared_bounds
from ovmot.evaluation.ego import NEES_DOF, EgoSeries
from ovmot.geometry.arrays import FloatArray

_ERROR, _BOUND = "#1f5fa8", "#b04a3a"
_LEGEND = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 3, "frameon": False}
_DOTS_PER_INCH = 110


def error_figure(series: EgoSeries) -> Figure:
    """Six panels over time: orientation error (deg) and position error (m), with 3-sigma bounds."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    panels = figure.subplots(3, 2, sharex=True)
    seconds = _seconds(series)
    for column, (part, unit, scale, frame) in enumerate(
        (("Orientation", "deg", np.degrees(1.0), "body"), ("Position", "m", 1.0, "world"))
    ):
        for row, axis in enumerate("xyz"):
            panel = panels[row, column]
            k = 3 * column + row
            _draw_error(
                panel, seconds, scale * series.errors[:, k], scale * series.three_sigma[:, k]
            )
            panel.set_ylabel(f"{axis} [{unit}]")
        panels[0, column].set_title(f"{part} error, {frame} axes")
        panels[2, column].set_xlabel("time since the first compared pose [s]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure


def nees_figure(series: EgoSeries) -> Figure:
    """NEES of orientation and position over time, with the 95 % band of one value."""
    figure = Figure(figsize=(12.0, 6.0), layout="constrained")
    names = ("orientation", "position")
    seconds = _seconds(series)
    for panel, name in zip(figure.subplots(2, 1, sharex=True), names, strict=True):
        _draw_nees(panel, seconds, series.nees[name], NEES_DOF[name])
        panel.set_ylabel(f"NEES, {name} [-]")
        panel.legend(**_LEGEND)
    panel.set_xlabel("time since the first compared pose [s]")
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; raises `OvmotError` where that is not possible."""
    try:
        figure.savefig(path, format="png", dpi=_DOTS_PER_INCH)
    except OSError as error:
        raise OvmotError(f"{path}: cannot be written: {error.strerror}") from None


def _draw_error(
    panel: Axes, seconds: FloatArray, error: FloatArray, three_sigma: FloatArray
) -> None:
    panel.axhline(0.0, color="0.7", linewidth=0.8)
    if np.any(np.isfinite(three_sigma)):
        panel.fill_between(seconds, -three_sigma, three_sigma, color=_BOUND, alpha=0.12, lw=0.0)
        panel.plot(seconds, three_sigma, color=_BOUND, linewidth=1.0, label="3-sigma bound")
        panel.plot(seconds, -three_sigma, color=_BOUND, linewidth=1.0)
    panel.plot(seconds, error, color=_ERROR, linewidth=1.3, label="error (true - estimated)")
    # what is shown in full is the error, and the bound but for a short peak of it
    bound = three_sigma[np.isfinite(three_sigma)]
    usual = float(np.percentile(bound, 98.0)) if len(bound) else 0.0
    top = max(1.15 * float(np.abs(error).max()), 1.1 * usual)
    if top > 0.0:
        panel.set_ylim(-top, top)
    _frame(panel, seconds)


def _draw_nees(panel: Axes, seconds: FloatArray, values: FloatArray, dof: int) -> None:
    """A logarithmic axis: an overconfident filter is off by orders."""
    low, high = chi_squared_bounds(dof)
    panel.axhspan(low, high, color="#3a8a4d", alpha=0.15, label=f"95 % band of χ²({dof})")
    panel.axhline(dof, color="#3a8a4d", linewidth=1.0, linestyle="--", label=f"expected: {dof}")
    known = np.isfinite(values)
    if np.any(known):
        mean = float(values[known].mean())
        panel.plot(seconds, values, color=_ERROR, linewidth=1.3, label=f"NEES (mean {mean:.3g})")
    else:
        panel.text(0.5, 0.5, "the run states no covariance", transform=panel.transAxes, ha="center")
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    positive = values[known & (values > 0.0)]
    top = max(3.0 * high, 1.5 * float(positive.max(initial=0.0)))
    panel.set_ylim(0.3 * low, top)
    _frame(panel, seconds)


def _frame(panel: Axes, seconds: FloatArray) -> None:
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    if len(seconds) > 1:
        panel.set_xlim(float(seconds[0]), float(seconds[-1]))


def _seconds(series: EgoSeries) -> FloatArray:
    seconds: FloatArray = (series.timestamp_ns - series.timestamp_ns[0]) * 1e-9
    return seconds
