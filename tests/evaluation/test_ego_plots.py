import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.lines import Line2D

from ovmot.errors import OvmotError
from ovmot.evaluation.consistency import chi_squared_bounds
from ovmot.evaluation.ego import EgoSeries
from ovmot.evaluation.ego_plots import error_figure, nees_figure, save_figure
from ovmot.geometry.arrays import FloatArray


@pytest.fixture
def series() -> EgoSeries:
    """Ten poses, 0.1 s apart; each panel has a slope of its own."""
    rising = np.arange(10.0)[:, None] * 0.01
    return EgoSeries(
        timestamp_ns=10**18 + 10**8 * np.arange(10, dtype=np.int64),
        errors=rising * np.array([1.0, -2.0, 3.0, 4.0, 5.0, -6.0]),
        three_sigma=rising * 10.0 + 0.02,
        nees={"orientation": np.linspace(1.0, 40.0, 10), "position": np.full(10, 3.0)},
        position_true=np.zeros((10, 3)),
        position_aligned=np.zeros((10, 3)),
    )


def y_of(line: Line2D) -> FloatArray:
    return np.asarray(line.get_ydata(), dtype=np.float64)


def test_six_panels_show_the_errors_in_degrees_and_metres(series: EgoSeries) -> None:
    series = replace(series, three_sigma=np.broadcast_to(series.three_sigma, (10, 6)))
    panels = error_figure(series).axes
    assert [panel.get_ylabel() for panel in panels] == [
        "x [deg]", "x [m]", "y [deg]", "y [m]", "z [deg]", "z [m]",
    ]  # fmt: skip
    for panel, k in zip(panels, (0, 3, 1, 4, 2, 5), strict=True):
        scale = np.degrees(1.0) if k < 3 else 1.0
        lines = {str(line.get_label()): line for line in panel.get_lines()}
        error = lines["error (true - estimated)"]
        np.testing.assert_allclose(y_of(error), scale * series.errors[:, k])
        x = np.asarray(error.get_xdata(), dtype=np.float64)
        np.testing.assert_allclose(x, 0.1 * np.arange(10))
        bound = lines["3-sigma bound"]
        np.testing.assert_allclose(y_of(bound), scale * series.three_sigma[:, k])
        low, high = panel.get_ylim()
        assert low <= (scale * series.errors[:, k]).min()
        assert high >= (scale * series.errors[:, k]).max()


def test_nees_is_shown_with_its_band(series: EgoSeries) -> None:
    for panel, name in zip(nees_figure(series).axes, ("orientation", "position"), strict=True):
        assert panel.get_ylabel() == f"NEES, {name} [-]"
        (curve,) = [line for line in panel.get_lines() if len(np.asarray(line.get_xdata())) == 10]
        np.testing.assert_array_equal(y_of(curve), series.nees[name])
        (band,) = panel.patches
        extents = band.get_path().get_extents(band.get_patch_transform())
        assert (extents.y0, extents.y1) == pytest.approx(chi_squared_bounds(3))
        assert panel.get_ylim()[1] > series.nees[name].max()


def test_a_run_without_covariance_is_said_to_have_none(series: EgoSeries) -> None:
    unknown = np.full(10, np.nan)
    series = replace(
        series,
        three_sigma=np.full((10, 6), np.nan),
        nees={"orientation": unknown, "position": unknown},
    )
    for panel in nees_figure(series).axes:
        assert [text.get_text() for text in panel.texts] == ["the run states no covariance"]
    labels = [str(line.get_label()) for line in error_figure(series).axes[0].get_lines()]
    assert "3-sigma bound" not in labels
    assert "error (true - estimated)" in labels


def test_figures_are_saved_as_images(series: EgoSeries, tmp_path: Path) -> None:
    save_figure(nees_figure(series), tmp_path / "nees.png")
    image = cv2.imread(str(tmp_path / "nees.png"), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (660, 1320, 3)
    assert image.std() > 5.0
    with pytest.raises(OvmotError, match=r"no/nees.png: cannot be written"):
        save_figure(nees_figure(series), tmp_path / "no" / "nees.png")


def test_one_pose_is_enough(series: EgoSeries, tmp_path: Path) -> None:
    one = EgoSeries(
        series.timestamp_ns[:1], np.zeros((1, 6)), np.zeros((1, 6)),
        {"orientation": np.zeros(1), "position": np.zeros(1)}, np.zeros((1, 3)), np.zeros((1, 3)),
    )  # fmt: skip
    for name, figure in (("e.png", error_figure(one)), ("n.png", nees_figure(one))):
        save_figure(figure, tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_no_window_system_is_asked_for() -> None:
    code = "import sys, ovmot.evaluation.ego_plots; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
