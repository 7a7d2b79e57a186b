"""A stereo history against the hypothesis that the points are static, under the ego motion.

What the kernels take of a history, a window and a rig; used by the tests of motion and by the
clustering of moving points.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.segmentation.comparison_kernel import EgoMotion, Pairs, StereoNoise
from ovmot.segmentation.history_kernel import ego_motion_compiled
from ovmot.types import PoseWindow


def pairs_of(history: StereoHistory) -> Pairs:
    """The stereo pairs and positions of a history."""
    return Pairs(history.then, history.p_then, history.now, history.p_now)


def ego_motion_since(history: StereoHistory, window: PoseWindow, rig: StereoRig) -> EgoMotion:
    """The left camera's motion since each earlier frame of a history, with its covariance."""
    clone = np.searchsorted(window.timestamp_ns, history.clone_ns)
    T_now_then, covariance = ego_motion_compiled(
        np.ascontiguousarray(window.T_world_imu),
        np.ascontiguousarray(window.covariance),
        clone,
        np.ascontiguousarray(rig.T_imu_cam0),
    )
    return EgoMotion(T_now_then, covariance, history.span_s)


def stereo_noise(history: StereoHistory, sigma_px: float, rig: StereoRig) -> StereoNoise:
    """The stereo extrinsics and the noise of a history's pixels, in normalized units.

    `sigma_px`: that of each coordinate of a pair, as `PixelNoise` has it.
    """
    noise = history.noise
    return StereoNoise(
        np.ascontiguousarray(rig.T_cam1_cam0),
        rig.normalized_sigma(sigma_px),
        noise.drift_sigma_px(history.n_frames) / rig.cam0.fx,
        float(noise.drift_per_flow),
    )
