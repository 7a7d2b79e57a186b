"""What one frame shows the bodies: its features' views and places, and the rig's step to it."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.triangulation import stereo_covariance
from ovmot.objects.body_kernel import EgoStep
from ovmot.objects.body_step_kernel import FrameViews
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.types import PixelNoise, PoseWindow


def views_now(
    xy: FloatArray, motions: FeatureMotions, now_ns: int, window: PoseWindow,
    before: PoseWindow | None, rig: StereoRig, noise: PixelNoise,
) -> FrameViews:  # fmt: skip
    """The newest frame's, by the normalized coordinates (N, 4) of its features and their places;
    `before`: the window of the last one."""
    T_world_cam0 = window.T_world_imu[-1] @ rig.T_imu_cam0
    common, correction = _last_common(window, before)
    return FrameViews(
        now_ns, motions.feature_id, xy, motions.p_world, motions.position_cov, T_world_cam0,
        se3.inverse(T_world_cam0), np.ascontiguousarray(rig.T_cam1_cam0),
        rig.normalized_sigma(noise.sigma_px) ** 2, rig.cam0.fx, rig.baseline,
        drift_variance(noise, rig, 1), noise.drift_per_flow,
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
                drift_variance(
                    history.noise, rig, int(history.n_frames[before] - history.n_frames[row])
                ),
                history.noise.drift_per_flow,
                ego_step(window, int(clone[before]), int(clone[row]), T),
                np.eye(4),
            )
        )
    return frames


def drift_variance(noise: PixelNoise, rig: StereoRig, n_frames: int) -> float:
    """Variance, rad², of a patch's drift over some frames."""
    return n_frames * (noise.drift_per_frame_px / rig.cam0.fx) ** 2


def ego_step(window: PoseWindow, before: int, now: int, T_world_cam0: FloatArray) -> EgoStep:
    """The rig's step between two clones of the window."""
    index = np.concatenate([6 * before + np.arange(6), 6 * now + np.arange(6)])
    return EgoStep(
        np.ascontiguousarray(window.T_world_imu[[before, now]]),
        np.ascontiguousarray(window.covariance[index][:, index]),
        np.ascontiguousarray(T_world_cam0[:3, 3]),
    )
