"""A stereo history against the hypothesis that the points are static, under the ego motion.

A point p_then, mapped by the ego motion into the present left camera, should be seen where the
present stereo pair sees it, if it is static.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.segmentation.history_kernel import compare_points_compiled
from ovmot.types import PoseWindow


@dataclass(frozen=True, slots=True)
class StaticComparison:
    """L earlier times against now, for N features; NaN where there is no stereo pair.

    `span_s` (L,): time between. `predicted` (L, N, 3): the earlier point mapped into the present
    left camera, metres. `residual` (L, N, 4): observed minus predicted normalized coordinates of
    both views; `J` (L, N, 4, 3): derivative of the prediction by the point; `J_motion`
    (L, N, 4, 3): residual = J_motion (position now - predicted), exactly, however far the point has
    gone. `S` (L, N, 4, 4): covariance of the residual of a static point (pixels then and now, patch
    drift, ego motion), `S_motion` the same for one that has gone to where it is seen now.
    """

    span_s: FloatArray
    predicted: FloatArray
    residual: FloatArray
    J: FloatArray
    J_motion: FloatArray
    S: FloatArray
    S_motion: FloatArray

    @property
    def tested(self) -> BoolArray:
        """Which comparisons (L, N) exist."""
        usable = np.isfinite(self.residual).all(-1) & np.isfinite(self.S).all((-1, -2))
        return np.asarray(usable)


def compare_with_static(
    history: StereoHistory, window: PoseWindow, rig: StereoRig
) -> StaticComparison:
    """Map the earlier points into the present camera and compare, with covariances.

    C_predicted = R C_then Rᵀ + (ego motion's part); S = J C_predicted Jᵀ + pixel noise now + drift
    of the tracked patch.
    """
    clone = np.searchsorted(window.timestamp_ns, history.clone_ns)
    noise = history.noise
    return StaticComparison(
        history.span_s,
        *compare_points_compiled(
            history.p_then,
            history.cov_then,
            history.then,
            history.p_now,
            history.now,
            static_motion(history, window, rig),
            _ego_covariance(clone, window, rig),
            np.ascontiguousarray(rig.T_cam1_cam0),
            rig.normalized_sigma(noise.sigma_px),
            noise.drift_sigma_px(history.n_frames) / rig.cam0.fx,
            noise.drift_per_flow,
        ),
    )


def static_motion(history: StereoHistory, window: PoseWindow, rig: StereoRig) -> FloatArray:
    """T_now_then (L, 4, 4) of static points, from each earlier left camera into the present one."""
    clone = np.searchsorted(window.timestamp_ns, history.clone_ns)
    T_world_cam0 = window.T_world_imu @ rig.T_imu_cam0
    return se3.inverse(T_world_cam0[-1]) @ T_world_cam0[clone]


def _ego_covariance(clone_index: IntArray, window: PoseWindow, rig: StereoRig) -> FloatArray:
    """Covariance (L, 6, 6) of (φ, τ): a predicted point p of the present left camera moves by
    [p]x φ + τ as the two poses err.

    In the IMU's frame, with R = R_nᵀ R_t and t = R_nᵀ (t_t - t_n), p_now = R p_t + t moves by
    [p_now]x (δθ_n - R δθ_t) + [t]x R δθ_t + R_nᵀ (δt_t - δt_n), poses perturbed on the right.
    """
    T_now, T_then = window.T_world_imu[-1], window.T_world_imu[clone_index]
    relative = se3.inverse(T_now) @ T_then
    R, t = relative[:, :3, :3], relative[:, :3, 3]
    A = np.zeros((len(clone_index), 6, 12))
    A[:, :3, :3], A[:, :3, 6:9] = np.eye(3), -R
    A[:, 3:, 3:6], A[:, 3:, 9:] = -T_now[:3, :3].T, T_now[:3, :3].T
    A[:, 3:, 6:9] = so3.hat(t) @ R
    # into the camera's axes and about its centre
    R_cam0_imu = rig.T_imu_cam0[:3, :3].T
    A = np.concatenate([R_cam0_imu @ A[:, :3], R_cam0_imu @ A[:, 3:]], axis=1)
    A[:, 3:] += so3.hat(R_cam0_imu @ rig.T_imu_cam0[:3, 3]) @ A[:, :3]
    last = len(window.timestamp_ns) - 1
    pose = np.column_stack([np.full_like(clone_index, last), clone_index])
    index = (6 * pose[..., None] + np.arange(6)).reshape(-1, 12)
    P = window.covariance[index[:, :, None], index[:, None, :]]
    out: FloatArray = A @ P @ np.swapaxes(A, 1, 2)
    return out
