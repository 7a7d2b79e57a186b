"""Static initialization: a stationary IMU gives tilt and gyro bias; no jerk is needed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import MIN_POINTS, motion_is_significant, solve_stereo_motion
from ovmot.initialization.stereo_path import occupied_cells
from ovmot.physics import (
    GYRO_BIAS_SIGMA_RPS,
    MAX_ACCEL_BIAS_MPS2,
    REST_SHIFT_M,
    tracked_pixel_sigma,
)
from ovmot.settings import InitializationSettings
from ovmot.types import FrontendFrame, ImuData, tracked_pixels
from ovmot.vio.state import ImuState


@dataclass(frozen=True, slots=True)
class StaticSolution:
    """The state of a stationary rig, and the features (N,) that kept their place."""

    state: ImuState
    feature_id: IntArray


@dataclass(frozen=True, slots=True)
class StationaryPoints:
    """Features (N,) that kept their place over a window, and their share of those tracked over it.

    `cells`: how much space they occupy, and `moving_cells`: how much those that most move together
    do, 0 where none do; see `occupied_cells`.
    """

    feature_id: IntArray
    share: float
    cells: int
    moving_cells: int


def static_initialization(
    frames: Sequence[FrontendFrame],
    imu: ImuData,
    rig: StereoRig,
    settings: InitializationSettings,
    gravity: float,
    max_pixels: float,
    least_share: float | None = None,
) -> StaticSolution:
    """The state of a rig that is stationary over the frames and the IMU samples.

    `gravity`: its magnitude, m/s²; `max_pixels`: by how much a stationary point may move;
    `least_share`: which share of the points must be stationary, by default that of the settings.
    Raises `InitializationError` where IMU or images say that the rig moves.
    """
    check_imu_is_stationary(imu, settings, gravity)
    points = stationary_points(frames, rig, max_pixels)
    check_images_are_stationary(points, settings, least_share)
    return StaticSolution(stationary_state(imu), points.feature_id)


def check_imu_is_stationary(imu: ImuData, settings: InitializationSettings, gravity: float) -> None:
    """Raise `InitializationError` where the IMU says that the rig moves."""
    force = float(np.linalg.norm(imu.accel.mean(0)))
    if abs(force - gravity) > MAX_ACCEL_BIAS_MPS2:
        raise InitializationError(
            f"accelerometer measures {force:.2f} m/s²"
            f" (stationary within {MAX_ACCEL_BIAS_MPS2:g} of {gravity:g})"
        )
    gyro, accel = float(imu.gyro.std(0).max()), float(imu.accel.std(0).max())
    if gyro > settings.rest_gyro_rps:
        raise InitializationError(
            f"gyroscope varies by {gyro:.3f} rad/s (stationary below {settings.rest_gyro_rps:g})"
        )
    if accel > settings.rest_accel_mps2:
        raise InitializationError(
            f"accelerometer varies by {accel:.3f} m/s²"
            f" (stationary below {settings.rest_accel_mps2:g})"
        )


def stationary_points(
    frames: Sequence[FrontendFrame], rig: StereoRig, max_pixels: float
) -> StationaryPoints:
    """The features that moved less than `max_pixels` from the first frame to the last."""
    first, last = frames[0], frames[-1]
    _, a, b = np.intersect1d(first.feature_id, last.feature_id, return_indices=True)
    displacement = tracked_pixels(last.pixels[b]) - tracked_pixels(first.pixels[a])
    stationary = np.linalg.norm(displacement, axis=1) < max_pixels
    if len(a) < MIN_POINTS:
        return StationaryPoints(last.feature_id[b[stationary]], 0.0, 0, 0)
    before, now = first.normalized[a], last.normalized[b]
    # a creeping rig moves all points, though few show it; one behind a truck all but the truck's
    everything = np.ones(len(a), dtype=np.bool_)
    sigma = rig.normalized_sigma(tracked_pixel_sigma(len(frames) - 1))
    span_s = 1e-9 * (last.timestamp_ns - first.timestamp_ns)
    moving_cells = max(
        _moving_cells(before[c], now[c], rig, sigma, span_s) for c in (everything, ~stationary)
    )
    return StationaryPoints(
        last.feature_id[b[stationary]],
        float(stationary.mean()),
        occupied_cells(before[stationary], rig),
        moving_cells,
    )


def _moving_cells(
    before: FloatArray, now: FloatArray, rig: StereoRig, sigma: FloatArray, span_s: float
) -> int:
    """Cells occupied by those of the stereo points (N, 4) that move together, 0 without motion.

    `sigma` (4,) of normalized coordinates. The gyroscope varies little, its bias is unknown.
    """
    rotation_sigma = GYRO_BIAS_SIGMA_RPS * span_s
    motion = solve_stereo_motion(before, now, rig.T_cam1_cam0, np.eye(3), sigma, rotation_sigma)
    if motion is None or not motion_is_significant(motion, REST_SHIFT_M):
        return 0
    return occupied_cells(before[motion.inlier], rig)


def check_images_are_stationary(
    points: StationaryPoints, settings: InitializationSettings, least_share: float | None = None
) -> None:
    """Raise `InitializationError` where the images say that the rig moves.

    `least_share`: which share of the points must be stationary, by default that of the settings.

    Traffic may fill most of the view of a stationary rig, and a car ahead at the rig's own speed
    keeps its place in the image. The body that occupies more space is the world.
    """
    least = settings.rest_share if least_share is None else least_share
    if points.share < least:
        raise InitializationError(
            f"only {100 * points.share:.0f} % of the points are stationary"
            f" (at least {100 * least:.0f} %)"
        )
    if points.moving_cells >= max(points.cells, 1):
        raise InitializationError(
            f"moving points occupy {points.moving_cells} cells of space, stationary ones"
            f" {points.cells} (more when stationary)"
        )


def stationary_state(imu: ImuData) -> ImuState:
    """The state of a stationary IMU, with yaw, position and velocity zero.

    The mean specific force gives the tilt, the mean rate is the gyro bias. Tilt and accelerometer
    bias are not separately observable: the bias is taken as zero.
    """
    zero = np.zeros(3)
    R = gravity_aligned_rotation(imu.accel.mean(0))
    return ImuState(R, zero, zero, imu.gyro.mean(0), zero)


def gravity_aligned_rotation(up: FloatArray) -> FloatArray:
    """R_world_body (3, 3) that turns the direction `up` (3,) in body to +z, with zero yaw of the x
    axis."""
    R = so3.between_vectors(up, np.array([0.0, 0.0, 1.0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    return so3.exp(np.array([0.0, 0.0, -yaw])) @ R
