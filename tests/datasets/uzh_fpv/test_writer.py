"""What a written UZH-FPV or TUM-VI folder cannot hold."""

from dataclasses import replace
from pathlib import Path

import pytest
from written_formats import (
    SEED,
)

from ovmot.cameras.camera import Camera
from ovmot.datasets.registry import WRITERS
from ovmot.errors import InputError
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


@pytest.mark.parametrize("form", ["tum_vi", "uzh_fpv"])
def test_kalibr_files_hold_no_skew(form: str, small_simulation: Simulation, tmp_path: Path) -> None:
    skewed = Camera.make((160, 70), (100, 100), (80, 35), "none", skew=0.1)
    rig = replace(small_simulation.rig, cam0=skewed)
    with pytest.raises(InputError, match=r"skew of 0\.1"):
        next(WRITERS[form](tmp_path / "new", record(replace(small_simulation, rig=rig), SEED)))
    assert not (tmp_path / "new").exists()
