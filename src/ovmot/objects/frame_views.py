"""What one frame shows the bodies: its features' views and places, and the rig's step to it."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import stereo_covariance
from ovmot.objects.body_kernel import EgoStep
from ovmot.types import PixelNoise, PoseWindow, ScenePoints


@dataclass(frozen=True, slots=True)
class FrameViews:
    """N features of one frame.

    `xy` (N, 4): normalized, NaN where unseen; `p_world` (N, 3): places by this stereo pair alone
    with covariance (N, 3, 3), NaN without one. `variance` (4,): of the normalized coordinates;
    `n_frames`: since the frame before. `step`: the rig's since then; `correction` (4, 4): of the
    world since the last frame was processed.
    """

    timestamp_ns: int
    feature_id: IntArray
    xy: FloatArray
    p_world: FloatArray
    cov_world: FloatArray
    T_world_cam0: FloatArray
    T_cam0_world: FloatArray
    T_cam1_cam0: FloatArray
    variance: FloatArray
    focal: float
    baseline: float
    noise: PixelNoise
    n_frames: int
    step: EgoStep
    correction: FloatArray

    def has_place(self, at: IntArray) -> BoolArray:
        """Which rows (k,), -1 for none, have a stereo pair."""
        out = at >= 0
        out[out] = np.isfinite(self.p_world[at[out], 0])
        return out

    def drift_variance(self, flow: FloatArray) -> FloatArray:
        """Variances (n,), rad², by which patches drift while they move by (n, 2), normalized."""
        per_frame = self.n_frames * (self.noise.drift_per_frame_px / self.focal) ** 2
        way = np.nan_to_num((flow**2).sum(-1))
        return np.asarray(per_frame + self.noise.drift_per_flow**2 * way)


def views_now(
    points: ScenePoints, now_ns: int, window: PoseWindow, before: PoseWindow | None,
    rig: StereoRig, noise: PixelNoise,
) -> FrameViews:  # fmt: skip
    """The newest frame's, by its points; `before`: the window of the last one."""
    T_world_cam0 = window.T_world_imu[-1] @ rig.T_imu_cam0
    R = T_world_cam0[:3, :3]
    common, correction = _last_common(window, before)
    return FrameViews(
        now_ns, points.feature_id, rig.normalize(points.pixels),
        se3.apply(T_world_cam0, points.p_cam0), R @ points.cov_cam0 @ R.T, T_world_cam0,
        se3.inverse(T_world_cam0), np.ascontiguousarray(rig.T_cam1_cam0),
        rig.normalized_sigma(noise.sigma_px) ** 2, rig.cam0.fx, rig.baseline, noise, 1,
        ego_step(window, common, len(window.timestamp_ns) - 1, T_world_cam0), correction,
    )  # fmt: skip


def _last_common(window: PoseWindow, before: PoseWindow | None) -> tuple[int, FloatArray]:
    """The newest clone that both windows hold, and how its pose was corrected (4, 4)."""
    if before is not None:
        for k in range(len(window.timestamp_ns) - 1, -1, -1):
            at = np.flatnonzero(before.timestamp_ns == window.timestamp_ns[k])
            if len(at):
                T_old = before.T_world_imu[at[0]]
                return k, window.T_world_imu[k] @ se3.inverse(T_old)
    return max(len(window.timestamp_ns) - 2, 0), np.eye(4)


def views_then(
    history: StereoHistory, rows: list[int], ids: IntArray, now_ns: int, window: PoseWindow,
    rig: StereoRig,
) -> list[FrameViews]:  # fmt: skip
    """Those of features (K,) at earlier frames, rows of the history."""
    frames = []
    at = np.flatnonzero(np.isin(history.feature_id, ids))
    sigma = rig.normalized_sigma(history.noise.single_px)
    clone = np.searchsorted(window.timestamp_ns, history.clone_ns)
    for k, row in enumerate(rows):
        T = window.T_world_imu[clone[row]] @ rig.T_imu_cam0
        p_then = history.p_then[row, at]
        C = stereo_covariance(p_then, rig.T_cam1_cam0, sigma)
        before = rows[max(k - 1, 0)]
        frames.append(
            FrameViews(
                now_ns - round(1e9 * history.span_s[row]),
                history.feature_id[at],
                np.ascontiguousarray(history.then[row, at]),
                se3.apply(T, p_then),
                T[:3, :3] @ C @ T[:3, :3].T,
                T,
                se3.inverse(T),
                np.ascontiguousarray(rig.T_cam1_cam0),
                rig.normalized_sigma(history.noise.sigma_px) ** 2,
                rig.cam0.fx,
                rig.baseline,
                history.noise,
                int(history.n_frames[before] - history.n_frames[row]),
                ego_step(window, int(clone[before]), int(clone[row]), T),
                np.eye(4),
            )
        )
    return frames


def ego_step(window: PoseWindow, before: int, now: int, T_world_cam0: FloatArray) -> EgoStep:
    """The rig's step between two clones of the window."""
    index = np.concatenate([6 * before + np.arange(6), 6 * now + np.arange(6)])
    return EgoStep(
        np.ascontiguousarray(window.T_world_imu[[before, now]]),
        np.ascontiguousarray(window.covariance[index][:, index]),
        np.ascontiguousarray(T_world_cam0[:3, 3]),
    )
