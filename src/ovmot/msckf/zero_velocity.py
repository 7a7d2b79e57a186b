"""Standing still: how it is recognised, and the update it allows.

The filter's own prediction must agree with standing (chi-squared), and the picture must show it
too: moving cars leave the share of still points high only while the rig stands. Neither alone is
enough: a smooth drive looks like rest to the IMU, and a lead car at our own speed looks still.
"""

import numpy as np

from ovmot.config import ZeroVelocitySettings
from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.msckf.state import VELOCITY, State, clone_columns
from ovmot.msckf.update import chi2_bound, ekf_update, innovation_distance

SIGMA_VELOCITY = 0.02  # m/s
SIGMA_ROTATION = 2e-4  # rad between the two poses
SIGMA_POSITION = 2e-3  # m between the two poses
_PREDICTION_SLACK = 3.0  # the prediction's covariance is optimistic; ask for agreement within this


def still_share(
    pixels: FloatArray, earlier: FloatArray, candidates: BoolArray, pixel: float
) -> float:
    """Share of candidate points whose left image position moved less than `pixel`.

    `pixels`, `earlier` (N, 2), NaN where unseen; 0 with fewer than 8 points to look at.
    """
    both = candidates & np.isfinite(pixels[:, 0]) & np.isfinite(earlier[:, 0])
    if both.sum() < 8:
        return 0.0
    moved = np.linalg.norm(pixels[both] - earlier[both], axis=1)
    return float((moved < pixel).mean())


def standing_measurement(state: State) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Zero velocity, and zero motion between the two newest clones: H, columns, r, variance."""
    now, before = len(state.clones) - 1, len(state.clones) - 2
    T_now, T_before = state.clones.T_world_imu[now], state.clones.T_world_imu[before]
    R_relative = T_before[:3, :3].T @ T_now[:3, :3]
    columns = np.r_[
        np.arange(VELOCITY.start, VELOCITY.stop),
        np.arange(*clone_columns(before).indices(len(state.covariance))),
        np.arange(*clone_columns(now).indices(len(state.covariance))),
    ]
    H = np.zeros((9, 15))
    H[:3, :3] = np.eye(3)
    # φ = log(R_beforeᵀ R_now): a right error of `now` adds J_r^-1 δ, one of `before` -J_l^-1 δ.
    phi = so3.log(R_relative)
    H[3:6, 9:12] = so3.right_jacobian_inverse(phi)
    H[3:6, 3:6] = -so3.right_jacobian_inverse(-phi)
    H[6:9, 12:15] = np.eye(3)
    H[6:9, 6:9] = -np.eye(3)
    residual = -np.concatenate([state.imu.velocity, phi, T_now[:3, 3] - T_before[:3, 3]])
    sigma = np.repeat([SIGMA_VELOCITY, SIGMA_ROTATION, SIGMA_POSITION], 3)
    return H, columns, residual, sigma**2


def is_standing(state: State, share: float, settings: ZeroVelocitySettings) -> bool:
    """Do prediction and picture both say that the rig has not moved since the last clone?"""
    if not settings.enabled or len(state.clones) < 2 or share < settings.still_share:
        return False
    H, columns, residual, variance = standing_measurement(state)
    distance = innovation_distance(state, H, columns, residual, _PREDICTION_SLACK * variance)
    return distance < _PREDICTION_SLACK * chi2_bound(len(residual), 0.999)


def zero_velocity_update(state: State) -> State:
    """The state corrected by standing still between its two newest clones."""
    return ekf_update(state, *standing_measurement(state))
