"""Fixtures that tests of several folders share."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.geometry.arrays import FloatArray


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder with real and rendered sequences; the test skips where it is missing."""
    repository = Path(__file__).resolve().parents[1]
    root = Path(os.environ.get("OVMOT_DATA", repository.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no data in {root}; set OVMOT_DATA to run this test")
    return root


@pytest.fixture(scope="session")
def central_differences() -> Callable[..., FloatArray]:
    """Derivative (..., m, n) of function (n,) -> (..., m) at a point (n,), by central steps."""

    def derivative(
        function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-6
    ) -> FloatArray:
        steps = step * np.eye(len(at))
        columns = [(function(at + d) - function(at - d)) / (2.0 * step) for d in steps]
        return np.stack(columns, axis=-1)

    return derivative
