"""Zero-velocity detection by images and by the prediction, and the zero-velocity update (ZUPT).

Detection needs both. A smooth drive looks like rest to an IMU; a car ahead at the rig's own speed
looks stationary in the images. The images are compared over some tenths of a second: from one frame
to the next a creeping rig moves less than a match is accurate.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import MIN_POINTS, motion_is_significant, solve_stereo_motion
from ovmot.kernels.table_kernel import count_still_compiled
from ovmot.physics import (
    FRAME_JITTER,
    REST_SHIFT_M,
    REST_SPEED_MPS,
    REST_STEP_M,
    REST_TURN_RAD,
    VARIANCE_FACTOR,
    gate,
    tracked_pixel_sigma,
)
from ovmot.settings import ZeroVelocitySettings
from ovmot.vio.state import VELOCITY, State
from ovmot.vio.update import ekf_update, innovation_distance


def zero_velocity_detected(
    state: State,
    table: FeatureTable,
    history: StereoHistory,
    rig: StereoRig,
    settings: ZeroVelocitySettings,
) -> bool:
    """Do the images and the prediction both allow that the rig is stationary?"""
    return image_is_stationary(table, history, rig, settings) and prediction_is_stationary(state)


def image_is_stationary(
    table: FeatureTable,
    history: StereoHistory,
    rig: StereoRig,
    settings: ZeroVelocitySettings,
    *,
    look_back_s: float = 0.5,
) -> bool:
    """Do most points of the newest frame keep their place, and is their stereo motion zero?

    `history` is that of the table's newest frame. Compared is the oldest frame of it that is at
    most `look_back_s` old, in which time a creep of some centimetres a second shows; False while
    there is none at least half as old. Outliers and dynamic features are left out.
    """
    recent = np.flatnonzero(history.span_s <= look_back_s * (1.0 + FRAME_JITTER))
    if len(recent) == 0 or history.span_s[recent[0]] < 0.5 * look_back_s:
        return False
    k, column = int(recent[0]), table.columns(history.feature_id)
    candidates = np.flatnonzero(~(table.outlier | table.dynamic).take(column))
    then, now = table.pixels[history.row[k]], table.pixels[-1]
    if stationary_share(now, then, column[candidates], settings.pixel) < settings.still_share:
        return False
    return not _has_moved(history.only(candidates), k, rig)


def stationary_share(
    pixels: FloatArray, earlier: FloatArray, column: IntArray, max_pixels: float
) -> float:
    """Share of the features of some columns (n,) that moved less than `max_pixels` in their image.

    `pixels`, `earlier` (F, 4): rows of the table; 0 with fewer than 8 features to compare.
    """
    n_both, n_still = count_still_compiled(earlier, pixels, column, max_pixels)
    return 0.0 if n_both < MIN_POINTS else n_still / n_both


def prediction_is_stationary(state: State) -> bool:
    """Is a zero velocity since the last clone within the gate of what the filter has predicted?"""
    if len(state.clones) < 2:
        return False
    H, columns, residual, variance = zero_velocity_measurement(state)
    distance = innovation_distance(state, H, columns, residual, variance)
    return distance < VARIANCE_FACTOR * gate(len(residual), 0.999)


def zero_velocity_update(state: State) -> State:
    """The state updated by zero velocity, and zero motion between its two newest clones."""
    return ekf_update(state, *zero_velocity_measurement(state))


def zero_velocity_measurement(
    state: State,
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """H (9, 15), columns (15,), residual (9,) and variance (9,) of a stationary rig.

    Rows: velocity, m/s; then rotation, rad, and translation, m, between the two newest clones.
    """
    now, before = len(state.clones) - 1, len(state.clones) - 2
    T_now, T_before = state.clones.T_world_imu[now], state.clones.T_world_imu[before]
    columns = np.r_[
        np.arange(VELOCITY.start, VELOCITY.stop),
        np.arange(*state.clone_columns(before).indices(len(state.covariance))),
        np.arange(*state.clone_columns(now).indices(len(state.covariance))),
    ]
    H = np.zeros((9, 15))
    H[:3, :3] = np.eye(3)
    # φ = log(R_beforeᵀ R_now): a right error of `now` adds J_r^-1 δ, one of `before` -J_l^-1 δ
    phi = so3.log(T_before[:3, :3].T @ T_now[:3, :3])
    H[3:6, 9:12] = so3.right_jacobian_inverse(phi)
    H[3:6, 3:6] = -so3.right_jacobian_inverse(-phi)
    H[6:9, 12:15] = np.eye(3)
    H[6:9, 6:9] = -np.eye(3)
    residual = -np.concatenate([state.imu.velocity, phi, T_now[:3, 3] - T_before[:3, 3]])
    sigma = np.repeat([REST_SPEED_MPS, REST_TURN_RAD, REST_STEP_M], 3)
    return H, columns, residual, sigma**2


def _has_moved(history: StereoHistory, k: int, rig: StereoRig, *, max_points: int = 60) -> bool:
    """Is there a translation since time `k` of the history beyond its uncertainty and a centimetre?

    Of a stationary rig the rotation is known; the `max_points` nearest points tell the translation
    best.
    """
    disparity = np.nan_to_num(history.then[k, :, 0] - history.then[k, :, 2])
    nearest = history.only(np.argsort(-disparity, kind="stable")[:max_points])
    n_frames = int(history.n_frames[k])
    motion = solve_stereo_motion(
        nearest.then[k], nearest.now, rig.T_cam1_cam0, np.eye(3),
        rig.normalized_sigma(tracked_pixel_sigma(n_frames)), REST_TURN_RAD * np.sqrt(n_frames),
    )  # fmt: skip
    if motion is None:
        return False  # too few stereo points to say
    return motion_is_significant(motion, REST_SHIFT_M)
