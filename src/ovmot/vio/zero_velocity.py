"""The update that standing still allows, and whether the filter's prediction admits it.

That the picture stands is judged in `stillness.py`; both must agree. A smooth drive looks like rest
to the IMU, and a lead car at our own speed looks still.
"""

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import ZeroVelocitySettings
from ovmot.vio.state import VELOCITY, State
from ovmot.vio.update import chi2_bound, ekf_update, innovation_distance

_PREDICTION_SLACK = 3.0  # the prediction's covariance is optimistic; ask for agreement within this


def standing_measurement(
    state: State, settings: ZeroVelocitySettings
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Zero velocity, and zero motion between the two newest clones: H, columns, r, variance."""
    now, before = len(state.clones) - 1, len(state.clones) - 2
    T_now, T_before = state.clones.T_world_imu[now], state.clones.T_world_imu[before]
    R_relative = T_before[:3, :3].T @ T_now[:3, :3]
    columns = np.r_[
        np.arange(VELOCITY.start, VELOCITY.stop),
        np.arange(*state.clone_columns(before).indices(len(state.covariance))),
        np.arange(*state.clone_columns(now).indices(len(state.covariance))),
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
    sigma = np.repeat(
        [settings.velocity_sigma_mps, settings.rotation_sigma_rad, settings.position_sigma_m], 3
    )
    return H, columns, residual, sigma**2


def prediction_allows_standing(state: State, settings: ZeroVelocitySettings) -> bool:
    """Is standing since the last clone within what the filter has predicted?"""
    if len(state.clones) < 2:
        return False
    H, columns, residual, variance = standing_measurement(state, settings)
    distance = innovation_distance(state, H, columns, residual, _PREDICTION_SLACK * variance)
    return distance < _PREDICTION_SLACK * chi2_bound(len(residual), 0.999)


def zero_velocity_update(state: State, settings: ZeroVelocitySettings) -> State:
    """The state corrected by standing still between its two newest clones."""
    return ekf_update(state, *standing_measurement(state, settings))
