"""Written 4Seasons recordings: rectified pinholes, whatever the rig's cameras are."""

from pathlib import Path

import numpy as np
from written_formats import SEED, of_form, with_fisheye

from ovmot.cameras.rig import rectified
from ovmot.datasets import open_sequence
from ovmot.datasets.four_seasons.writer import write_four_seasons
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


def test_fisheye_cameras_become_rectified_pinholes(
    small_simulation: Simulation, tmp_path: Path
) -> None:
    simulation = of_form("4seasons", small_simulation)
    bent = record(simulation, SEED)
    bent = type(bent)(
        with_fisheye(bent.rig), bent.camera_ns, bent.path, bent.T_vehicle_imu, bent.imu, bent.frames
    )
    assert list(write_four_seasons(tmp_path, bent)) == simulation.camera_ns.tolist()
    rig, expected = open_sequence(tmp_path).rig, rectified(bent.rig)
    assert {camera.model.name for camera in rig.cameras} == {"none"}
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, :3], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(rig.T_imu_cam0, expected.T_imu_cam0, atol=1e-9)
    assert (tmp_path / "truth/objects.json").exists()
