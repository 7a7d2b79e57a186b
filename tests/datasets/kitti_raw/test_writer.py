"""Written KITTI raw drives."""

from dataclasses import replace
from pathlib import Path

import pytest
from written_formats import (
    SEED,
    with_fisheye,
)

from ovmot.datasets.registry import WRITERS
from ovmot.errors import InputError
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


def test_kitti_files_hold_no_fisheye(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = replace(small_simulation, rig=with_fisheye(small_simulation.rig))
    with pytest.raises(InputError, match="camera model 'equidistant'; use radtan"):
        next(WRITERS["kitti_extract"](tmp_path / "new", record(simulation, SEED)))
