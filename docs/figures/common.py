"""What the figures share: colours, sizes, and the simulated streets that they show."""

from pathlib import Path
from typing import Any

import matplotlib

import ovmot

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
STREETS = ROOT / "build" / "figures"
"""Simulated data and runs; they may be deleted, and are then made anew."""

BLUE, ORANGE, GREEN, PINK, SKY, RED, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#777777",
)  # fmt: skip
"""Colours that the colour-blind can tell apart (M. Okabe and K. Ito, 2008)."""
COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, RED)


def figure(width: float = 7.0, height: float = 3.0, columns: int = 1, rows: int = 1) -> Any:
    """A figure of so many inches, and its axes."""
    plt.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3})
    return plt.subplots(rows, columns, figsize=(width, height), layout="constrained")


def save(made: Any, name: str, folder: Path = IMAGES, kind: str = "png") -> Path:
    """Write a figure, and close it: lines as PNG, photographs as JPEG, some tens of kilobytes."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.{kind}"
    further = {"metadata": {"Software": None}} if kind == "png" else {"pil_kwargs": {"quality": 70}}
    made.savefig(path, dpi=110, **further)
    plt.close(made)
    return path


def street(scene: str, **simulated: Any) -> tuple[Path, ovmot.Run]:
    """The folder of a simulated street with its truth, and a run on it; made where missing."""
    name = "_".join([scene, *(f"{key}{value}" for key, value in sorted(simulated.items()))])
    name = "".join(letter for letter in name if letter.isalnum() or letter in "_.")
    data, out = STREETS / name / "data", STREETS / name / "out"
    if not (data / "truth" / "objects.json").exists():
        print(f"simulate {name}", flush=True)
        ovmot.simulate(scene, **simulated).write(data)
    if not (out / "run.json").exists() or ovmot.Run(out).summary["ended"] != "finished":
        print(f"run {name}", flush=True)
        options = ovmot.RunOptions(out, save_points=True, force=True)
        ovmot.run_sequence(ovmot.open(data), ovmot.Settings(), options)
    return data, ovmot.Run(out)
