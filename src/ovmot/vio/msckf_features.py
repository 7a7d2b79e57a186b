"""Visual measurements of MSCKF features: residuals, Jacobians and nullspace projection, batched.

A. Mourikis & S. Roumeliotis, ICRA 2007. Clone poses enter the Jacobians at their first estimates,
the residual at the latest ones.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import ManyViewPoints, triangulate_many_views
from ovmot.physics import gates
from ovmot.vio.online_calibration import (
    CAMERA_INTRINSICS,
    CAMERA_POSES,
    OnlineCalibration,
    camera_pose_jacobian,
    intrinsics_jacobian,
)
from ovmot.vio.state import Clones, State

_IMAGE_MARGIN = 0.1  # of the image's width: a linearization this far outside still holds


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
class FeatureSystem:
    """Linear measurements of F features over K clones, whitened by the pixel noise.

    `H` (F, M, C + 6K) over the calibration and the clones, `H_point` (F, M, 3), `residual` (F, M)
    with M = 4K rows, zero where a view did not see the feature; `n_rows` (F,): how many were seen.
    """

    H: FloatArray
    H_point: FloatArray
    residual: FloatArray
    n_rows: IntArray


@dataclass(frozen=True, slots=True)
class PointRows:
    """The rows that determine F points: R δp + H x = residual, with white noise of variance 1.

    `R` (F, 3, 3), upper triangular, `H` (F, 3, C + 6K), `residual` (F, 3).
    """

    R: FloatArray
    H: FloatArray
    residual: FloatArray

    def rows(self, kept: BoolArray) -> "PointRows":
        """Those of the points `kept` (F,)."""
        return PointRows(self.R[kept], self.H[kept], self.residual[kept])


@dataclass(frozen=True, slots=True)
class NullspaceSystem:
    """Measurements of F features: rows that determine the points, and rows in their left nullspace.

    `H` (F, M - 3, C + 6K) and `residual` (F, M - 3) do not depend on the points; their noise is
    independent of that of `points`. `dof` (F,): degrees of freedom of the residual, rows seen - 3.
    """

    points: PointRows
    H: FloatArray
    residual: FloatArray
    dof: IntArray


def triangulate_features(
    state: State,
    rig: StereoRig,
    normalized: FloatArray,
    sigma_px: float,
) -> ManyViewPoints:
    """Points (F, 3) in world of features seen as `normalized` (F, K, 4) from the state's K clones.

    `rig`: as calibrated now; `sigma_px`: standard deviation of a pixel coordinate. Points whose
    depth is not in `DEPTH_RANGE_M` are not valid.
    """
    n_features, n_clones, _ = normalized.shape
    T_imu_world = se3.inverse(state.clones.T_world_imu)
    T_views = np.stack(
        [se3.inverse(rig.T_imu_cam0) @ T_imu_world, se3.inverse(rig.T_imu_cam1) @ T_imu_world], 1
    ).reshape(2 * n_clones, 4, 4)
    views = normalized.reshape(n_features, 2 * n_clones, 2)
    return triangulate_many_views(views, T_views, sigma_px / rig.cam0.fx, depth_range=DEPTH_RANGE_M)


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
        in_image[..., rows] = camera.inside(at_first, -_IMAGE_MARGIN * camera.width)[..., None]
        J_imu = J @ T_cam_imu[:3, :3]
        by_point[..., rows, :] = J_imu @ first[None, :, :3, :3]
        by_pose[..., rows, :3] = J_imu @ by_theta
        by_pose[..., rows, 3:] = -by_point[..., rows, :]
        columns = calibration.columns(CAMERA_POSES[side])
        if columns is not None:
            by_camera_pose = camera_pose_jacobian(
                calibration, CAMERA_POSES[side], p_cam, T_cam_imu[:3, :3]
            )
            by_calibration[..., rows, columns] = J @ by_camera_pose
        columns = calibration.columns(CAMERA_INTRINSICS[side])
        if columns is not None:
            by_calibration[..., rows, columns] = intrinsics_jacobian(camera, p_cam)
    seen = in_image & np.isfinite(residual) & np.isfinite(by_pose).all(-1)

    def whitened(values: FloatArray) -> FloatArray:
        return np.where(seen[..., None], values / sigma_px, 0.0)

    return Reprojection(
        np.where(seen, residual / sigma_px, 0.0), whitened(by_pose), whitened(by_point),
        whitened(by_calibration), seen,
    )  # fmt: skip


def linearize(
    state: State, rig: StereoRig, pixels: FloatArray, p_world: FloatArray, sigma_px: float
) -> FeatureSystem:
    """The measurements of features seen as `pixels` (F, K, 4) at points (F, 3); see `reproject`."""
    n_features, n_clones, _ = pixels.shape
    r = reproject(
        state.clones, rig, pixels, (p_world, p_world), sigma_px, state.calibration
    )  # fmt: skip
    H = np.zeros((n_features, n_clones, 4, n_clones, 6))
    k = np.arange(n_clones)
    H[:, k, :, k, :] = np.moveaxis(r.by_pose, 1, 0)
    m = 4 * n_clones
    by_calibration = r.by_calibration.reshape(n_features, m, len(state.calibration))
    return FeatureSystem(
        np.concatenate([by_calibration, H.reshape(n_features, m, 6 * n_clones)], axis=2),
        r.by_point.reshape(n_features, m, 3),
        r.residual.reshape(n_features, m),
        r.seen.sum((1, 2)),
    )


def project_nullspace(system: FeatureSystem) -> NullspaceSystem:
    """Nullspace projection: the same measurements in rows of which only three depend on the point.

    Three Householder reflections, on all features at once, bring H_point to triangular form; the
    rows below are those of the left nullspace of H_point.
    """
    A = triangularize(
        np.concatenate([system.H_point, system.H, system.residual[..., None]], axis=2), 3
    )
    point = PointRows(A[:, :3, :3], A[:, :3, 3:-1], A[:, :3, -1])
    return NullspaceSystem(point, A[:, 3:, 3:-1], A[:, 3:, -1], system.n_rows - 3)


def triangularize(A: FloatArray, n_columns: int) -> FloatArray:
    """Matrices A (F, M, N) with the first `n_columns` columns zero below the diagonal.

    By Householder reflections (G. Golub & C. Van Loan, sec. 5.2): white noise stays white.
    """
    A = A.copy()
    for j in range(n_columns):
        x = A[:, j:, j]
        v = x.copy()
        sign = np.where(x[:, 0] < 0.0, -1.0, 1.0)
        v[:, 0] += sign * np.linalg.norm(x, axis=1)
        length = (v * v).sum(1)
        v *= np.sqrt(2.0 / np.where(length > 0.0, length, 1.0))[:, None]
        A[:, j:] -= v[:, :, None] * (v[:, None, :] @ A[:, j:])
    return A


def innovation_distances(P: FloatArray, H: FloatArray, residual: FloatArray) -> FloatArray:
    """Squared Mahalanobis distance (F,) of each feature's innovation: rᵀ (H P Hᵀ + I)⁻¹ r.

    `P` (N, N): covariance of the coordinates that H (F, M, N) multiplies; `residual` (F, M).
    """
    HP = (H.reshape(-1, len(P)) @ P).reshape(H.shape)  # one product for all features
    S = HP @ np.swapaxes(H, -1, -2) + np.eye(H.shape[1])
    distance: FloatArray = (residual * np.linalg.solve(S, residual[..., None])[..., 0]).sum(-1)
    return distance


def chi2_gate(distance: FloatArray, dof: IntArray, multiplier: float) -> BoolArray:
    """Features (F,) whose squared distance (F,) is below the 95 % gate of their `dof` (F,)."""
    bounds = gates(np.maximum(dof, 1).astype(np.float64), 0.95)
    passed: BoolArray = (distance < multiplier * bounds) & (dof > 0)
    return passed
