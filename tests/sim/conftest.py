"""A small street that the writers' tests write, and what they compare."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.sim.rigs import street_rig
from ovmot.sim.scenes import demo_simulation
from ovmot.sim.simulation import Simulation


def shrunk(camera: Camera) -> Camera:
    """A quarter of the camera's picture: the same lens, cheaper."""
    fx, fy, cx, cy, skew = camera.intrinsics
    return replace(
        camera, width=160, height=70,
        intrinsics=np.array([fx / 4, fy / 4, (cx - 1.5) / 4, (cy - 1.5) / 4, skew]),
    )  # fmt: skip


@pytest.fixture(scope="session")
def small_simulation() -> Simulation:
    """Half a second of the demo's street, 160x70 pixels, five frames."""
    demo = demo_simulation(seed=3, duration_s=0.5)
    rig = street_rig()
    return replace(demo, rig=replace(rig, cam0=shrunk(rig.cam0), cam1=shrunk(rig.cam1)))


@pytest.fixture(scope="session")
def assert_same_rig() -> Callable[[StereoRig, StereoRig], None]:
    """Holds cameras and poses of a rig that was read against the true one, not its clock."""

    def check(found: StereoRig, true: StereoRig) -> None:
        for a, b in zip(found.cameras, true.cameras, strict=True):
            assert (a.width, a.height, a.lens.name) == (b.width, b.height, b.lens.name)
            np.testing.assert_allclose(a.intrinsics, b.intrinsics, rtol=1e-12)
            np.testing.assert_allclose(a.distortion, b.distortion, rtol=1e-12)
        np.testing.assert_allclose(found.T_imu_cam0, true.T_imu_cam0, atol=1e-9)
        np.testing.assert_allclose(found.T_imu_cam1, true.T_imu_cam1, atol=1e-9)

    return check
