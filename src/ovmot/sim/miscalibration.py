"""A calibration that is wrong by known amounts, to be found by the filter."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.settings import Section


class Miscalibration(Section):
    """How far a calibration is off; directions and signs are drawn, for each camera its own."""

    rotation_deg: float = Field(0.0, ge=0.0)
    """Each camera's rotation on the IMU, about a random axis."""
    position_m: float = Field(0.0, ge=0.0)
    """Each camera's position, in a random direction."""
    focal_share: float = Field(0.0, ge=0.0, lt=0.5)
    """Each camera's focal lengths, as a share, both longer or both shorter."""
    time_offset_s: float = Field(0.0, ge=0.0)
    """The clock's offset, too early or too late."""


def miscalibrated(rig: StereoRig, error: Miscalibration, rng: np.random.Generator) -> StereoRig:
    """The rig of a calibration file that is wrong by these amounts."""

    def moved(T: FloatArray) -> FloatArray:
        turn = so3.exp(np.radians(error.rotation_deg) * _direction(rng))
        return se3.make(T[:3, :3] @ turn, T[:3, 3] + error.position_m * _direction(rng))

    def scaled(camera: Camera) -> Camera:
        factor = 1.0 + error.focal_share * rng.choice([-1.0, 1.0])
        return replace(camera, intrinsics=camera.intrinsics * [factor, factor, 1.0, 1.0, 1.0])

    offset_s = rig.time_offset_s + error.time_offset_s * float(rng.choice([-1.0, 1.0]))
    return replace(
        rig, cam0=scaled(rig.cam0), cam1=scaled(rig.cam1), T_imu_cam0=moved(rig.T_imu_cam0),
        T_imu_cam1=moved(rig.T_imu_cam1), time_offset_s=offset_s,
    )  # fmt: skip


def _direction(rng: np.random.Generator) -> FloatArray:
    """A random unit vector (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))
