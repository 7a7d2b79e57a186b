"""Feature-level simulations along recorded paths, with the settings of OpenVINS's simulator."""

from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.sim.features import FeatureOptions, FeatureSimulation
from ovmot.sim.paths import MARGIN_S
from ovmot.sim.recorded_paths import MAX_GAP_S, recorded_path
from ovmot.sim.simulation import ImuModel
from ovmot.types import ImuNoise

ORIGIN_NS = 1_500_000_000_000_000_000
EUROC_NOISE = ImuNoise(gyro=1.6968e-4, gyro_walk=1.9393e-5, accel=2e-3, accel_walk=3e-3)
"""Of the ADIS16448 as EuRoC's files give it (M. Burri et al., IJRR 2016)."""


def handheld_rig() -> StereoRig:
    """A 752x480 rig of the build of EuRoC's sensor: 0.11 m baseline, wide and distorted."""
    left = Camera.make(
        (752, 480), (458.7, 457.3), (367.2, 248.4), "radtan", [-0.2834, 0.0740, 1.9e-4, 1.8e-5]
    )
    right = Camera.make(
        (752, 480), (457.6, 456.1), (380.0, 255.2), "radtan", [-0.2837, 0.0745, -1.0e-4, -3.6e-5]
    )
    # the camera stands upright on the IMU, turned a quarter about its optical axis
    R_imu_cam0 = so3.exp(np.array([0.0, 0.0, 0.5 * np.pi])) @ so3.exp(np.array([0.0, 0.025, 0.004]))
    T_imu_cam0 = se3.make(R_imu_cam0, np.array([-0.022, -0.065, 0.010]))
    T_cam0_cam1 = se3.make(
        so3.exp(np.array([-0.007, -0.001, 0.0025])), np.array([0.110, 0.0003, -0.001])
    )
    return StereoRig(left, right, T_imu_cam0, T_imu_cam0 @ T_cam0_cam1)


def handheld_simulation(
    path: Path,
    options: FeatureOptions,
    *,
    start_s: float = 0.0,
    duration_s: float | None = None,
    camera_hz: float = 10.0,
    imu_hz: float = 400.0,
    max_gap_s: float = MAX_GAP_S,
) -> FeatureSimulation:
    """`handheld_rig` along a TUM file's poses (see `recorded_path`), biases starting at zero.

    Raises `InputError` for a bad file, and for rates or a duration that leave no frame.
    """
    if not (0.1 <= camera_hz <= 200.0 and camera_hz <= imu_hz <= 10_000.0):
        problem = f"a camera at {camera_hz:g} Hz and an IMU at {imu_hz:g} Hz can not be simulated"
        raise InputError(f"{problem}; the camera takes 0.1 to 200 Hz, the IMU no less than it")
    motion = recorded_path(
        path, ORIGIN_NS, start_s=start_s, duration_s=duration_s, max_gap_s=max_gap_s
    )
    last_ns = motion.end_ns - round(1e9 * MARGIN_S)
    period_ns = round(1e9 / camera_hz)
    camera_ns = np.arange(ORIGIN_NS, last_ns + 1, period_ns, dtype=np.int64)
    imu = ImuModel(imu_hz, EUROC_NOISE, np.zeros(3), np.zeros(3))
    return FeatureSimulation(handheld_rig(), motion, camera_ns, imu, options)
