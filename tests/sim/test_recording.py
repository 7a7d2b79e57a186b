"""A rendered simulation as a sequence to be written."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.sim.recording import imu_samples, imu_times
from ovmot.sim.simulation import Simulation


@pytest.mark.parametrize("offset_s", [-0.31, 0.0, 0.4])
def test_the_imu_covers_all_frames_by_its_own_clock(
    small_simulation: Simulation, offset_s: float
) -> None:
    simulation = replace(
        small_simulation, rig=replace(small_simulation.rig, time_offset_s=offset_s)
    )
    times = imu_times(simulation)
    frames = simulation.camera_ns + round(1e9 * offset_s)
    assert times[0] < frames[0] - 400_000_000
    assert times[-1] > frames[-1] + 200_000_000
    assert np.all(np.diff(times) == 10_000_000)
    assert len(imu_samples(simulation, np.random.default_rng(0)).data) == len(times)
