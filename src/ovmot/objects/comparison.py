"""Stereo points then and now, compared under the ego motion.

Both positions come from stereo alone: a moving point can not be refined by repeated views. A
point p_then, carried by the ego motion into the present left camera, should be seen where the
present stereo pair sees it, if it stood still.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.types import PoseWindow


@dataclass(frozen=True, slots=True)
class Comparison:
    """L earlier rows against now, for N features; NaN where a feature was not seen in stereo.

    `span_s` (L,): time between. `predicted` (L, N, 3): the earlier point carried into the present
    left camera, metres. `residual` (L, N, 4): observed minus predicted plane coordinates of both
    views; `J` (L, N, 4, 3): derivative of the prediction by the point; `J_motion` (L, N, 4, 3):
    residual = J_motion (position now - predicted), exactly, however far the point has gone;
    `S` (L, N, 4, 4): covariance of the residual for a point at rest (pixels then and now, and the
    ego motion), `S_motion` the same for one that has gone to where it is seen now.
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


@dataclass(frozen=True, slots=True)
class StereoHistory:
    """Stereo pairs of N features at L earlier frames and now, as plane coordinates.

    `then` (L, N, 4), `now` (N, 4); `clone_index` (L,): the pose of each earlier frame in the
    window; `span_s` (L,): how long ago.
    """

    then: FloatArray
    now: FloatArray
    clone_index: IntArray
    span_s: FloatArray


@dataclass(frozen=True, slots=True)
class Slide:
    """How far a followed patch slides, standard deviation: `px` pixels, and `per_flow` of its way
    through the image."""

    px: float
    per_flow: float


def plane_sigma(rig: StereoRig, sigma_px: float) -> FloatArray:
    """Standard deviations (4,) of a stereo pair's plane coordinates."""
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    return sigma_px / np.array([f0[0], f0[1], f1[0], f1[1]])


def compare(
    history: StereoHistory,
    window: PoseWindow,
    rig: StereoRig,
    sigma_px: float,
    slide: Slide,
) -> Comparison:
    """Carry the earlier points into the present camera and compare, with covariances.

    C_predicted = R C_then Rᵀ + (ego motion's part); S = J C_predicted Jᵀ + pixel noise now + what
    a followed patch slides as its view changes.
    """
    sigma = plane_sigma(rig, sigma_px)
    T_c1_c0 = rig.T_cam1_cam0
    p_then = triangulate_stereo(history.then, T_c1_c0)
    C_then = stereo_covariance(p_then, T_c1_c0, sigma)

    T_world_cam0 = window.T_world_imu @ rig.T_imu_cam0
    T_now_then = se3.inverse(T_world_cam0[-1]) @ T_world_cam0[history.clone_index]
    predicted = se3.apply(T_now_then[:, None], p_then)
    predicted = np.where(predicted[..., 2:] > 0.1, predicted, np.nan)
    R = T_now_then[:, None, :3, :3]
    C = R @ C_then @ np.swapaxes(R, -1, -2)
    C = C + _ego_covariance(history.clone_index, p_then, window, rig)

    seen, J = project_stereo(predicted, T_c1_c0)
    flow = np.linalg.norm(history.now[:, :2] - history.then[..., :2], axis=-1)
    variance = (slide.px / rig.cam0.fx) ** 2 + (slide.per_flow * flow) ** 2
    noise = np.diag(sigma**2) + variance[..., None, None] * np.eye(4)
    S = J @ C @ np.swapaxes(J, -1, -2) + noise
    p_now = triangulate_stereo(history.now, T_c1_c0)
    _, J_now = project_stereo(p_now, T_c1_c0)
    S_motion = J_now @ C @ np.swapaxes(J_now, -1, -2) + noise
    J_motion = secant_jacobian(predicted, p_now, T_c1_c0)
    return Comparison(history.span_s, predicted, history.now - seen, J, J_motion, S, S_motion)


def secant_jacobian(p_from: FloatArray, p_to: FloatArray, T_cam1_cam0: FloatArray) -> FloatArray:
    """D (..., 4, 3) with h(p_to) - h(p_from) = D (p_to - p_from) for both views h, exactly.

    In one view, with x = X/Z: x' - x = ((X' - X) - x (Z' - Z)) / Z'.
    """
    out = np.zeros((*np.broadcast_shapes(p_from.shape, p_to.shape)[:-1], 4, 3))
    for side, T in enumerate((np.eye(4), T_cam1_cam0)):
        start, end = se3.apply(T, p_from), se3.apply(T, p_to)
        rows = np.zeros((*out.shape[:-2], 2, 3))
        rows[..., 0, 0] = rows[..., 1, 1] = 1.0
        rows[..., 2] = -start[..., :2] / start[..., 2:]
        out[..., 2 * side : 2 * side + 2, :] = rows / end[..., 2, None, None] @ T[:3, :3]
    return out


def _ego_covariance(
    clone_index: IntArray, p_then_cam0: FloatArray, window: PoseWindow, rig: StereoRig
) -> FloatArray:
    """Covariance (L, N, 3, 3) that the two poses' errors give to the carried point, camera frame.

    p_now = R_nᵀ (R_t p_t + t_t - t_n): by δθ_n: [p_now]x, by δt_n: -R_nᵀ,
    by δθ_t: -R_nᵀ R_t [p_t]x, by δt_t: R_nᵀ.
    """
    n_rows, n_features = p_then_cam0.shape[:2]
    T_now, T_then = window.T_world_imu[-1], window.T_world_imu[clone_index]
    p_then = se3.apply(rig.T_imu_cam0, p_then_cam0)
    p_now = se3.apply((se3.inverse(T_now) @ T_then)[:, None], p_then)
    R_now_T = T_now[:3, :3].T
    J = np.empty((n_rows, n_features, 3, 12))
    J[..., 0:3] = so3.hat(p_now)
    J[..., 3:6] = -R_now_T
    J[..., 6:9] = -(R_now_T @ T_then[:, None, :3, :3]) @ so3.hat(p_then)
    J[..., 9:12] = R_now_T
    last = len(window.timestamp_ns) - 1
    P = np.stack([_pair_covariance(window.covariance, last, int(k)) for k in clone_index])
    J = rig.T_imu_cam0[:3, :3].T @ J
    out: FloatArray = J @ P[:, None] @ np.swapaxes(J, -1, -2)
    return out


def _pair_covariance(covariance: FloatArray, a: int, b: int) -> FloatArray:
    """Joint covariance (12, 12) of clones a and b."""
    index = np.r_[6 * a : 6 * a + 6, 6 * b : 6 * b + 6]
    pair: FloatArray = covariance[np.ix_(index, index)]
    return pair
