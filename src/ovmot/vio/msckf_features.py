"""Visual measurements: triangulation, reprojection errors and the rows that features give.

A. Mourikis & S. Roumeliotis, ICRA 2007. Clone poses enter the Jacobians at their first estimates,
the residual at the latest ones.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.lens_kernel import packed_cameras
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.triangulation import MAX_DEPTH_M
from ovmot.physics import gates
from ovmot.settings import FilterSettings
from ovmot.vio.innovation_consistency import VELOCITY_BOUND
from ovmot.vio.msckf_kernel import update_by_features_compiled
from ovmot.vio.online_calibration import (
    CAMERA_INTRINSICS,
    CENTERS,
    MOUNT,
    STEREO,
    OnlineCalibration,
    camera_pose_jacobian,
    intrinsics_jacobian,
)
from ovmot.vio.reprojection_kernel import IMAGE_MARGIN
from ovmot.vio.state import N_BASE, Clones, State
from ovmot.vio.triangulation_kernel import triangulate_views_compiled

DEPTH_RANGE_M = (0.1, 150.0)
"""Triangulated points nearer or farther are not used: beyond, a window's parallax is noise."""


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Reprojection errors of F features seen from K clones, and the Jacobians of the prediction.

    `residual` (F, K, 4), `by_pose` (F, K, 4, 6), `by_point` (F, K, 4, 3), `by_calibration`
    (F, K, 4, C): whitened by the pixel noise, zero where a view did not see the feature; `seen`
    (F, K, 4).
    """

    residual: FloatArray
    by_pose: FloatArray
    by_point: FloatArray
    by_calibration: FloatArray
    seen: BoolArray


@dataclass(frozen=True, slots=True)
class PointRows:
    """The rows that determine F points: R δp + E (x, -1) = noise of variance 1, white.

    `R` (F, 3, 3), upper triangular, `E` (F, 3, C + 6K + 1).
    """

    R: FloatArray
    E: FloatArray

    def rows(self, kept: BoolArray) -> "PointRows":
        """Those of the points `kept` (F,)."""
        return PointRows(self.R[kept], self.E[kept])


@dataclass(frozen=True, slots=True)
class ConsistentFeatures:
    """One update by all features that are consistent.

    `weight` (F,): factor on each feature's rows, 0 for those left out, up to 1; `error` (N,) and
    `covariance` (N, N): what the update makes of the state; `points`: the rows that determine the
    points, of all features.
    """

    weight: FloatArray
    error: FloatArray
    covariance: FloatArray
    points: PointRows


def triangulate_features(
    state: State,
    rig: StereoRig,
    normalized: FloatArray,
    sigma_px: float,
) -> tuple[FloatArray, BoolArray]:
    """Points (F, 3) in world of features seen as `normalized` (F, K, 4), and which are valid (F,).

    From the state's K clones. `rig`: as calibrated now; `sigma_px`: standard deviation of a pixel
    coordinate. Points whose depth is not in `DEPTH_RANGE_M` are not valid.
    """
    views = np.ascontiguousarray(normalized).reshape(len(normalized), -1, 2)
    points, valid = triangulate_views_compiled(
        views, _view_poses(state.clones.T_world_imu, rig), sigma_px / rig.cam0.fx,
        np.array([*DEPTH_RANGE_M, MAX_DEPTH_M]),
    )  # fmt: skip
    return points, valid


def reproject(
    clones: Clones,
    rig: StereoRig,
    pixels: FloatArray,
    points: tuple[FloatArray, FloatArray],
    sigma_px: float,
    calibration: OnlineCalibration,
) -> Reprojection:
    """Reprojection errors in pixels / sigma, and the Jacobians by the error coordinates.

    `pixels` (F, K, 4), NaN where unseen; `points`: world points (F, 3) at the latest and at the
    first estimates; `rig` as calibrated now. With p_imu = Rᵀ(p - t): ∂p_imu/∂θ = [p_imu]x,
    ∂p_imu/∂t = -Rᵀ, ∂p_imu/∂p = Rᵀ.

    A view counts only where the linearization point lies in the image or close beside it: elsewhere
    1/z and the distortion polynomial explode, and the Jacobians do not hold.
    """
    shape = pixels.shape
    residual, by_pose = np.empty(shape), np.empty((*shape, 6))
    by_point, by_calibration = np.empty((*shape, 3)), np.zeros((*shape, len(calibration)))
    first = se3.inverse(clones.T_world_imu_first)
    p_imu = se3.apply(se3.inverse(clones.T_world_imu)[None], points[0][:, None])
    p_first = se3.apply(first[None], points[1][:, None])
    by_theta = so3.hat(p_first)
    in_image = np.empty(shape, dtype=np.bool_)
    for side, (camera, T_imu_cam) in enumerate(
        ((rig.cam0, rig.T_imu_cam0), (rig.cam1, rig.T_imu_cam1))
    ):
        T_cam_imu = se3.inverse(T_imu_cam)
        rows = slice(2 * side, 2 * side + 2)
        residual[..., rows] = pixels[..., rows] - camera.project(se3.apply(T_cam_imu, p_imu))
        p_cam = se3.apply(T_cam_imu, p_first)
        at_first, J = camera.project_with_jacobian(p_cam)
        in_image[..., rows] = camera.inside(at_first, -IMAGE_MARGIN * camera.width)[..., None]
        J_imu = J @ T_cam_imu[:3, :3]
        by_point[..., rows, :] = J_imu @ first[None, :, :3, :3]
        by_pose[..., rows, :3] = J_imu @ by_theta
        by_pose[..., rows, 3:] = -by_point[..., rows, :]
        by_calibration[..., rows, :] = calibration_jacobian(rig, side, p_first, J, calibration)
    seen = in_image & np.isfinite(residual) & np.isfinite(by_pose).all(-1)

    def whitened(values: FloatArray) -> FloatArray:
        return np.where(seen[..., None], values / sigma_px, 0.0)

    return Reprojection(
        np.where(seen, residual / sigma_px, 0.0), whitened(by_pose), whitened(by_point),
        whitened(by_calibration), seen,
    )  # fmt: skip


def consistent_features(
    state: State, rig: StereoRig, pixels: FloatArray, points: FloatArray, settings: FilterSettings
) -> ConsistentFeatures:
    """One update by those features that agree with each other and with the prediction.

    `rig` as calibrated now; `pixels` (F, K, 4) from the K clones, NaN where not to be used;
    `points` (F, 3): in world, where they are linearized. Each feature is gated at `chi2_multiplier`
    times the 95 % quantile, then all for consistency (see `innovation_consistency`).
    """
    clones = state.clones
    bounds = settings.chi2_multiplier * gates(4 * pixels.shape[1], 0.95)
    weight, error, covariance, R, E = update_by_features_compiled(
        points, pixels, calibration_jacobians(clones, rig, points, state.calibration),
        clones.T_world_imu, clones.T_world_imu_first,
        rig.T_cam_imu, *packed_cameras(rig),
        settings.pixel_sigma, state.covariance, N_BASE,
        state.calibration.n_considered, bounds, VELOCITY_BOUND,
    )  # fmt: skip
    return ConsistentFeatures(weight, error, covariance, PointRows(R, E))


def calibration_jacobian(
    rig: StereoRig, side: int, p_imu: FloatArray, J: FloatArray, calibration: OnlineCalibration
) -> FloatArray:
    """∂pixel/∂(calibration) (..., 2, C) of points (..., 3), m, in the IMU, in one camera.

    `J` (..., 2, 3): derivative of the pixel by the point in the camera.
    """
    out = np.zeros((*J.shape[:-1], len(calibration)))
    if not len(calibration):
        return out
    T_cam0_imu, T_cam1_cam0 = se3.inverse(rig.T_imu_cam0), rig.T_cam1_cam0
    p_cam = p_cam0 = se3.apply(T_cam0_imu, p_imu)
    J_cam0 = J
    if side == 1:
        R = T_cam1_cam0[:3, :3]
        p_cam, J_cam0 = se3.apply(T_cam1_cam0, p_cam0), J @ R
        columns = calibration.columns(STEREO)
        if columns is not None:
            out[..., columns] = J @ camera_pose_jacobian(
                calibration, STEREO, p_cam, R @ calibration.baseline_axes
            )
    columns = calibration.columns(MOUNT)
    if columns is not None:
        out[..., columns] = J_cam0 @ camera_pose_jacobian(
            calibration, MOUNT, p_cam0, T_cam0_imu[:3, :3]
        )
    columns = calibration.columns(CAMERA_INTRINSICS[side])
    if columns is not None:
        out[..., columns] = intrinsics_jacobian(rig.cameras[side], p_cam)
    columns = calibration.columns(CENTERS)
    if columns is not None:
        out[..., columns] = np.eye(4)[2 * side : 2 * side + 2]
    return out


def calibration_jacobians(
    clones: Clones, rig: StereoRig, points: FloatArray, calibration: OnlineCalibration
) -> FloatArray:
    """∂pixel/∂(calibration) (F, K, 4, C) of world points (F, 3), by the first estimates."""
    out = np.zeros((len(points), len(clones), 4, len(calibration)))
    if not calibration.n_estimated:
        out[...] = np.eye(4, len(calibration))  # of image centres, or nothing
    else:
        p_imu = se3.apply(se3.inverse(clones.T_world_imu_first)[None], points[:, None])
        for side, camera in enumerate(rig.cameras):
            T_cam_imu = se3.inverse((rig.T_imu_cam0, rig.T_imu_cam1)[side])
            _, J = camera.project_with_jacobian(se3.apply(T_cam_imu, p_imu))
            rows = slice(2 * side, 2 * side + 2)
            out[..., rows, :] = calibration_jacobian(rig, side, p_imu, J, calibration)
    return out


def _view_poses(T_world_imu: FloatArray, rig: StereoRig) -> FloatArray:
    """T_view_world (2K, 4, 4) of both cameras of each clone, clone by clone."""
    T = rig.T_cam_imu[None] @ se3.inverse(T_world_imu)[:, None]
    return np.ascontiguousarray(T.reshape(-1, 4, 4))
