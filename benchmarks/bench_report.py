"""Tables in Markdown, and the line that says on what they were measured."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

import cv2
import numba
import numpy as np

from ovmot.geometry.arrays import FloatArray


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns are as wide as their longest entry."""
    lines = [columns, *rows]
    width = [max(len(line[k]) for line in lines) for k in range(len(columns))]
    rule = ["-" * w for w in width]

    def text(cells: Sequence[str]) -> str:
        return "| " + " | ".join(c.ljust(w) for c, w in zip(cells, width, strict=True)) + " |"

    return "\n".join(text(cells) for cells in (columns, rule, *rows))


def spread(values: FloatArray, digits: int = 1) -> str:
    """Median / 95th percentile / greatest."""
    shown = (np.median(values), np.percentile(values, 95), np.max(values))
    return " / ".join(f"{value:.{digits}f}" for value in shown)


def machine(load_before: float, load_after: float) -> str:
    """Processor, libraries, and the machine's load average at the start and at the end."""
    return (
        f"{processor()}, {os.cpu_count()} cores, load average {load_before:.1f} at the start and"
        f" {load_after:.1f} at the end; Python {platform.python_version()}, NumPy {np.__version__},"
        f" OpenCV {cv2.__version__}, Numba {numba.__version__}."
    )


def load() -> float:
    """The load average of the last minute."""
    return os.getloadavg()[0]


def processor(description: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's name, as the system gives it."""
    if description.exists():
        for line in description.read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return " ".join(value.split())
    return platform.processor() or platform.machine()
