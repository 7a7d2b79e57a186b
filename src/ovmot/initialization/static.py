"""Start at rest: a resting IMU gives tilt and gyro bias; no jerk is needed."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import motion_is_significant, solve_stereo_motion
from ovmot.initialization.occupied_space import PIXEL_SIGMA, normalized_sigma, space_filled
from ovmot.settings import InitializationSettings
from ovmot.types import FrontendFrame, ImuData, tracked_pixels
from ovmot.vio.state import ImuState

MAX_GRAVITY_ERROR = 1.5
"""m/s² off gravity, of a start: more than the bias of any sensor, as wrong units are."""

_MIN_POINTS = 8
_ROTATION_SIGMA = 0.01  # rad over the window, of a rig whose gyroscope is quiet
_MIN_MOTION_M = 0.01  # less is a body rocking on its springs


@dataclass(frozen=True, slots=True)
class StandingPoints:
    """Features (N,) that kept their place over a window, their share of those in both its ends.

    `space` is how much room they fill and `moving_space` how much those that move together most
    do, 0 where none do; see `space_filled`.
    """

    feature_id: IntArray
    share: float
    space: int
    moving_space: int


def imu_restless(imu: ImuData, settings: InitializationSettings, gravity_mps2: float) -> str | None:
    """Why the IMU says that the rig can not rest, or None."""
    force = float(np.linalg.norm(imu.accel.mean(0)))
    if abs(force - gravity_mps2) > MAX_GRAVITY_ERROR:
        return (
            f"accelerometer measures {force:.2f} m/s²"
            f" (at rest within {MAX_GRAVITY_ERROR:g} of {gravity_mps2:g})"
        )
    gyro, accel = float(imu.gyro.std(0).max()), float(imu.accel.std(0).max())
    if gyro > settings.rest_gyro_rps:
        return f"gyroscope varies by {gyro:.3f} rad/s (at rest below {settings.rest_gyro_rps:g})"
    if accel > settings.rest_accel_mps2:
        return (
            f"accelerometer varies by {accel:.3f} m/s² (at rest below {settings.rest_accel_mps2:g})"
        )
    return None


def standing_points(
    first: FrontendFrame, last: FrontendFrame, rig: StereoRig, pixel: float
) -> StandingPoints:
    """The features that moved less than `pixel` in their image from one frame to another."""
    _, a, b = np.intersect1d(first.feature_id, last.feature_id, return_indices=True)
    moved = tracked_pixels(last.pixels[b]) - tracked_pixels(first.pixels[a])
    still = np.linalg.norm(moved, axis=1) < pixel
    if len(a) < _MIN_POINTS:
        return StandingPoints(last.feature_id[b[still]], 0.0, 0, 0)
    before, now = first.normalized[a], last.normalized[b]
    # A creep is a motion of all, though few points show it; a drive behind a truck one of the rest.
    everything = np.ones(len(a), dtype=np.bool_)
    moving_space = max(_moving_space(before[c], now[c], rig) for c in (everything, ~still))
    return StandingPoints(
        last.feature_id[b[still]],
        float(still.mean()),
        space_filled(before[still], rig),
        moving_space,
    )


def _moving_space(before: FloatArray, now: FloatArray, rig: StereoRig) -> int:
    """Room filled by those of stereo points (N, 4) that move together, 0 where they do not move."""
    sigma = normalized_sigma(rig, PIXEL_SIGMA)
    motion = solve_stereo_motion(before, now, rig.T_cam1_cam0, np.eye(3), sigma, _ROTATION_SIGMA)
    if motion is None or not motion_is_significant(motion, _MIN_MOTION_M):
        return 0
    return space_filled(before[motion.inlier], rig)


def image_restless(points: StandingPoints, settings: InitializationSettings) -> str | None:
    """Why the picture says that the rig can not rest, or None.

    Traffic may fill most of the view of a rig that rests, and a car ahead at our speed stands in a
    view that moves. What fills more room is the world.
    """
    if points.share < settings.rest_share:
        return (
            f"only {100 * points.share:.0f} % of the points stand still"
            f" (at rest at least {100 * settings.rest_share:.0f} %)"
        )
    if points.moving_space >= max(points.space, 1):
        return (
            f"what moves together fills {points.moving_space} cells of space,"
            f" what stands still {points.space} (at rest more)"
        )
    return None


def static_initialization(imu: ImuData) -> ImuState:
    """The state of a resting IMU, with yaw, position and velocity zero.

    The mean specific force levels the rig, the mean rate is the gyro bias. Tilt and accelerometer
    bias cannot be told apart: the bias is taken as zero.
    """
    zero = np.zeros(3)
    return ImuState(_level(imu.accel.mean(0)), zero, zero, imu.gyro.mean(0), zero)


def _level(force: FloatArray) -> FloatArray:
    """Rotation body to world that turns the specific force to +z, with zero yaw of the x axis."""
    R = so3.between_vectors(force, np.array([0.0, 0.0, 1.0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    return so3.exp(np.array([0.0, 0.0, -yaw])) @ R
