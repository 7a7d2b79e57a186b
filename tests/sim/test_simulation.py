"""A simulation as one value."""

import numpy as np

from ovmot.sim.imu_errors import NO_ERRORS
from ovmot.sim.simulation import ImuModel, Optics, Simulation
from ovmot.types import ImuNoise


def test_an_imu_has_no_systematic_errors_unless_asked() -> None:
    model = ImuModel(200.0, ImuNoise(1e-4, 1e-5, 1e-3, 1e-4), np.zeros(3), np.zeros(3))
    assert model.errors is NO_ERRORS
    assert not model.errors.any


def test_the_demo_s_parts_belong_together(small_simulation: Simulation) -> None:
    path, frames = small_simulation.path, small_simulation.camera_ns
    assert path.start_ns < frames[0] and frames[-1] < path.end_ns
    assert np.all(np.diff(frames) > 0)
    assert Optics() == Optics(noise_grey=2.0)  # no blur, no drift of the exposure
