"""A written TUM-VI folder."""

import shutil
from pathlib import Path

import numpy as np
from written_formats import (
    SEED,
    assert_same_imu,
    of_form,
)

from ovmot.datasets.registry import WRITERS, open_sequence
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


def test_dso_alone_is_tum_vi_too(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = of_form("tum_vi", small_simulation)
    list(WRITERS["tum_vi"](tmp_path / "whole", record(simulation, SEED)))
    shutil.copytree(tmp_path / "whole/dso", tmp_path / "room/dso")  # links become folders
    sequence = open_sequence(tmp_path / "room")
    assert (sequence.kind, sequence.name) == ("tum_vi", "room")
    np.testing.assert_array_equal(sequence.frame_ns, simulation.camera_ns)
    assert_same_imu(sequence, "tum_vi", simulation)
    whole = open_sequence(tmp_path / "whole" / "mav0")
    assert (whole.kind, whole.name) == ("tum_vi", "whole")
