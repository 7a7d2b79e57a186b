"""A rendered simulation as one value: the scene, the rig in it, and the sensors' imperfections."""

from dataclasses import dataclass

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu_errors import NO_ERRORS, ImuErrors
from ovmot.sim.scene import Scene
from ovmot.types import ImuNoise


@dataclass(frozen=True, slots=True)
class ImuModel:
    """An IMU: its rate, noise densities, the biases (3,) of the first sample, and its errors."""

    rate_hz: float
    noise: ImuNoise
    gyro_bias: FloatArray
    accel_bias: FloatArray
    errors: ImuErrors = NO_ERRORS


@dataclass(frozen=True, slots=True)
class Optics:
    """What stands between the scene and the images.

    `noise_grey` is the standard deviation of white noise, grey levels; `exposure_drift` the
    greatest change of the brightness, as a share; `defocus_px` the standard deviation of the lens's
    blur; `exposure_s` the time over which an image gathers light, its stamp in the middle.
    """

    noise_grey: float = 2.0
    exposure_drift: float = 0.0
    defocus_px: float = 0.0
    exposure_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Simulation:
    """All that makes a rendered sequence, apart from the noise's generator.

    `path` is T_world_imu(t) in camera time; `camera_ns` (N,) the exposures; `T_vehicle_imu` where
    the IMU sits on the vehicle.
    """

    scene: Scene
    rig: StereoRig
    path: PoseSpline
    camera_ns: IntArray
    T_vehicle_imu: FloatArray
    imu: ImuModel
    optics: Optics = Optics()
