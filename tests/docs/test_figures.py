"""The scripts that draw the docs' figures run, and every picture of the docs has one."""

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_blocks import PAGES, ROOT

FIGURES = ROOT / "docs" / "figures"
SMALL = {"seed": 3, "duration_s": 2.5, "size": (320, 140)}
SHOWN = re.compile(r"!\[[^\]]*\]\(([^)\s]+)\)")


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """A function from a script's name to its module, whose streets come into an empty folder."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(FIGURES))

    def module(name: str) -> Any:
        monkeypatch.setattr(importlib.import_module("common"), "STREETS", tmp_path / "streets")
        return importlib.import_module(name)

    yield module
    for name in set(sys.modules) - before:
        if (FIGURES / f"{name}.py").is_file():
            del sys.modules[name]


def test_depth_and_drift_by_hand(script: Any) -> None:
    rig = script("rig")
    sigma = rig.depth_sigma(np.array([10.0, 20.0]), 0.5, 400.0)
    assert sigma == pytest.approx([0.2828427, 1.1313708], rel=1e-6)
    still = rig.drift_sigma(np.array([2.0]), 0.0, 0.0, 0.0, 0.1)
    assert still == pytest.approx([0.2])
    tilted = rig.drift_sigma(np.array([2.0]), 0.0, 0.0, 0.01, 0.0)
    assert tilted == pytest.approx([9.81 * 0.01 * 8.0 / 6.0])


def test_figures_of_the_rig(script: Any, tmp_path: Path) -> None:
    drawn = script("rig").main(tmp_path)
    assert sorted(path.name for path in drawn) == [
        "rig_depth.png",
        "rig_imu.png",
        "rig_shutter.png",
    ]
    assert all(path.stat().st_size < 100_000 for path in drawn)


SCREENSHOTS = {"overlay.jpg", "report-light.jpg", "view-objects.jpg"}
"""Made by hand, from a page in a browser and from `ovmot run --video`."""


@pytest.mark.slow
def test_figures_of_runs(script: Any, tmp_path: Path) -> None:
    """On streets of 2.5 s; those of one scene and seed are made once."""
    drawn = [
        *script("results").main(tmp_path, **SMALL),
        *script("algorithm").main(tmp_path, **SMALL),
        *script("objects").main(tmp_path, ("traffic",), (3,), **SMALL),
        *script("limits").main(tmp_path, **SMALL),
        script("overlay").main(tmp_path, **SMALL),
    ]
    assert all(path.stat().st_size > 2000 for path in drawn)
    names = {path.name for path in [*drawn, *script("rig").main(tmp_path)]}
    assert names | SCREENSHOTS >= shown_pictures()


def shown_pictures() -> set[str]:
    """Names of the pictures in the pages; `overlay.jpg` is a frame of the video."""
    return {
        Path(link).name
        for page in PAGES
        for link in SHOWN.findall(page.read_text(encoding="utf-8"))
    }


def test_pictures_are_small() -> None:
    """The README's moving picture below 3 MB, all others below 150 kB."""
    for path in (ROOT / "docs" / "images").iterdir():
        limit = 3_000_000 if path.suffix == ".gif" else 150_000
        assert path.stat().st_size < limit, path.name
