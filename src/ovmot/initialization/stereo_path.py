"""The path of the rig by stereo from frame to frame, and which body in view is the world.

An IMU does not distinguish the world from a truck that drives straight on at constant speed: seen
from either, the same forces act. Points cannot be counted either, since a near truck has most of
them. But no vehicle occupies as much space as the street that it stands on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import solve_stereo_motion
from ovmot.geometry.triangulation import stereo_covariance, triangulate_stereo
from ovmot.physics import (
    CAR_SIZE_M,
    GYRO_BIAS_SIGMA_RPS,
    PIXEL_SIGMA,
    VARIANCE_FACTOR,
    epipolar_pixel_sigma,
    tracked_pixel_sigma,
)
from ovmot.types import FrontendFrame, ImuData
from ovmot.vio.imu_buffer import integrated_rotation

_NO_FEATURES = np.empty(0, dtype=np.int64)
_MAX_MOTIONS = 3
"""Of two frames, tried before one is taken: the world's and those of two vehicles."""


@dataclass(frozen=True, slots=True)
class StereoPath:
    """IMU poses T_first_imu (K, 4, 4) in the IMU's frame at the first of K frames.

    `position_sigma` (K,), m, and `rotation_sigma` (K,), rad: their standard deviations on each
    axis; `feature_id` (N,): the features that moved along.
    """

    T_first_imu: FloatArray
    position_sigma: FloatArray
    rotation_sigma: FloatArray
    feature_id: IntArray


def stereo_path(
    frames: Sequence[FrontendFrame],
    imu: Sequence[ImuData],
    rig: StereoRig,
    excluded: IntArray = _NO_FEATURES,
) -> StereoPath:
    """Chain the stereo motion of K consecutive frames; the gyroscope predicts each rotation.

    `imu`: the K - 1 intervals between them. The features `excluded` (N,) are left out, and from
    each step on those that did not move along: the path stays with one body. Raises
    `InitializationError` where two frames have no common motion.

    Which features move along is judged by the noise that these frames show. By one that is too
    large, far points agree with a near vehicle as well as with the world, and the motion between
    two frames becomes a mean of both.
    """
    R_cam_imu = rig.T_imu_cam0[:3, :3].T
    pixel_sigma = tracked_pixel_sigma(1, measured_pixel_sigma(frames, rig))
    sigma = rig.normalized_sigma(pixel_sigma)
    # what the path claims has room for errors of the lens, which no frame shows
    claimed = VARIANCE_FACTOR * max(PIXEL_SIGMA / pixel_sigma, 1.0) ** 2
    T_first_cam = [np.eye(4)]
    variances = [np.zeros(6)]
    inliers = _NO_FEATURES
    for before, now, samples in zip(frames[:-1], frames[1:], imu, strict=True):
        tracked, a, b = np.intersect1d(before.feature_id, now.feature_id, return_indices=True)
        kept = ~np.isin(tracked, excluded)
        tracked, a, b = tracked[kept], a[kept], b[kept]
        R = R_cam_imu @ integrated_rotation(samples).T @ R_cam_imu.T
        span_s = 1e-9 * (now.timestamp_ns - before.timestamp_ns)
        motion = solve_stereo_motion(
            before.normalized[a], now.normalized[b], rig.T_cam1_cam0, R, sigma,
            GYRO_BIAS_SIGMA_RPS * span_s, max_motions=_MAX_MOTIONS,
        )  # fmt: skip
        if motion is None:
            raise InitializationError(f"no common stereo motion among {len(a)} tracked points")
        in_stereo = np.isfinite(before.normalized[a] + now.normalized[b]).all(axis=1)
        excluded = np.union1d(excluded, tracked[in_stereo & ~motion.inlier])
        inliers = np.union1d(inliers, tracked[motion.inlier])
        T_first_cam.append(T_first_cam[-1] @ se3.inverse(motion.T_now_before))
        variances.append(variances[-1] + claimed * np.diag(motion.covariance))
    T = rig.T_imu_cam0 @ np.array(T_first_cam) @ se3.inverse(rig.T_imu_cam0)
    inliers = np.setdiff1d(inliers, excluded)
    rotation_sigma, position_sigma = np.sqrt(np.reshape(variances, (-1, 2, 3)).mean(axis=2)).T
    return StereoPath(T, position_sigma, rotation_sigma, inliers)


def measured_pixel_sigma(frames: Sequence[FrontendFrame], rig: StereoRig) -> float:
    """Standard deviation of each pixel of the stereo pairs of these frames, by the distances from
    their epipolar lines; `PIXEL_SIGMA` of few pairs. The motion has a robust loss for the tails."""
    pairs = np.concatenate([frame.normalized for frame in frames])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    ones = np.ones((len(pairs), 1))
    lines = np.concatenate([pairs[:, :2], ones], axis=1) @ rig.essential.T
    per_px = np.linalg.norm(lines[:, :2] / np.array([rig.cam1.fx, rig.cam1.fy]), axis=1)
    distance = np.abs((lines * np.concatenate([pairs[:, 2:], ones], axis=1)).sum(axis=1)) / per_px
    sigma = epipolar_pixel_sigma(distance, tails=1.0)
    return sigma if np.isfinite(sigma) else PIXEL_SIGMA


def occupied_cells(normalized: FloatArray, rig: StereoRig, *, max_depth_error: float = 0.1) -> int:
    """Number of cubes as wide as a car that hold stereo points of known depth.

    `normalized` (N, 4): coordinates of stereo pairs, NaN where unseen; `max_depth_error`: greatest
    standard deviation of the depth, as a share of it. Farther points keep their place in the image
    whatever moves.
    """
    p = triangulate_stereo(normalized, rig.T_cam1_cam0)
    p = p[np.isfinite(p).all(axis=1)]
    if not len(p):
        return 0
    C = stereo_covariance(p, rig.T_cam1_cam0, rig.normalized_sigma(PIXEL_SIGMA))
    p = p[np.sqrt(C[:, 2, 2]) < max_depth_error * p[:, 2]]
    return len(np.unique(np.floor(p / CAR_SIZE_M[1]).astype(np.int64), axis=0))
