"""A recorded run with its truth, and paths made by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.pose_files import Trajectory, read_tum
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


@pytest.fixture(scope="session")
def recorded() -> tuple[Trajectory, Trajectory]:
    """Truth and estimate of a run of the filter on a rendered street: every second frame, 20 s."""
    folder = Path(__file__).parent / "data"
    return read_tum(folder / "recorded_truth.tum"), read_tum(folder / "recorded_run.tum")


@pytest.fixture(scope="session")
def winding_path() -> Callable[[int], FloatArray]:
    """A function from N to poses (N, 4, 4) along a hilly, winding path of about 60 m."""

    def path(n: int) -> FloatArray:
        s = np.linspace(0.0, 1.0, n)
        position = np.stack([40.0 * s, 10.0 * np.sin(7.0 * s), 3.0 * np.sin(4.0 * s)], axis=-1)
        turn = np.stack([0.1 * np.sin(9.0 * s), 0.2 * np.cos(5.0 * s), 3.0 * s], axis=-1)
        return se3.make(so3.exp(turn), position)

    return path
