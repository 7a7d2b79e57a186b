"""A recorded run with its truth, and paths made by hand."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets.pose_files import Trajectory, read_tum
from ovmot.datasets.truth import ObjectTruth, read_object_truth
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


STAMP = 1_000


@pytest.fixture
def truth(tmp_path: Path) -> ObjectTruth:
    """One frame of 320x240: a moving car (id 1) and a parked one (id 2); a wall 6 m away."""
    folder = tmp_path / "data" / "truth"
    (folder / "depth").mkdir(parents=True)
    car = dict.fromkeys(("x", "y", "z", "yaw", "l", "w", "h", "vx", "vy", "yaw_rate"), 0.0)
    listed = [{"t_ns": STAMP, "objects": [
        {**car, "id": 1, "vx": 4.0, "visible_px": 900}, {**car, "id": 2, "visible_px": 900},
    ]}]  # fmt: skip
    (folder / "objects.json").write_text(json.dumps(listed))
    ids = np.zeros((240, 320), dtype=np.uint8)
    ids[100:140, 100:140], ids[100:140, 200:240] = 1, 2
    cv2.imwrite(str(folder / f"{STAMP}.png"), ids)
    depth = np.full((240, 320), 6 * 256, dtype=np.uint16)
    depth[:20] = 0
    depth[200:] = 3 * 256
    cv2.imwrite(str(folder / "depth" / f"{STAMP}.png"), depth)
    found = read_object_truth(tmp_path / "data")
    assert found is not None
    return found
