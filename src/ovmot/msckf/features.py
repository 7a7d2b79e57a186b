"""Visual measurements of MSCKF features: residuals and Jacobians of all of them at once.

A. Mourikis & S. Roumeliotis, ICRA 2007. Clone poses enter the Jacobians at their first estimates,
the residual at the latest ones.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import ManyViewPoints, triangulate_many_views
from ovmot.msckf.state import FIRST_CLONE, State
from ovmot.msckf.update import chi2_bound


@dataclass(frozen=True, slots=True)
class FeatureSystem:
    """Linear measurements of F features over K clones, whitened by the pixel noise.

    `H_pose` (F, M, 6K), `H_point` (F, M, 3), `residual` (F, M) with M = 4K rows, zero where a
    view did not see the feature; `n_rows` (F,): how many rows are real.
    """

    H_pose: FloatArray
    H_point: FloatArray
    residual: FloatArray
    n_rows: IntArray


def triangulate_features(
    state: State,
    rig: StereoRig,
    normalized: FloatArray,
    sigma_px: float,
    depth_range: tuple[float, float],
) -> ManyViewPoints:
    """Points of features seen as `normalized` (F, K, 4) from the state's K clones."""
    n_features, n_clones, _ = normalized.shape
    T_imu_world = se3.inverse(state.clones.T_world_imu)
    T_views = np.stack(
        [se3.inverse(rig.T_imu_cam0) @ T_imu_world, se3.inverse(rig.T_imu_cam1) @ T_imu_world], 1
    ).reshape(2 * n_clones, 4, 4)
    views = normalized.reshape(n_features, 2 * n_clones, 2)
    return triangulate_many_views(views, T_views, sigma_px / rig.cam0.fx, depth_range=depth_range)


def linearize(
    state: State, rig: StereoRig, pixels: FloatArray, p_world: FloatArray, sigma_px: float
) -> FeatureSystem:
    """Reprojection errors in pixels / sigma and their derivatives, in the error coordinates.

    `pixels` (F, K, 4), NaN where unseen; `p_world` (F, 3). With p_imu = Rᵀ(p - t):
    ∂p_imu/∂θ = [p_imu]x, ∂p_imu/∂t = -Rᵀ, ∂p_imu/∂p = Rᵀ.
    """
    n_features, n_clones, _ = pixels.shape
    residual = np.empty((n_features, n_clones, 4))
    J_pose = np.empty((n_features, n_clones, 4, 6))
    J_point = np.empty((n_features, n_clones, 4, 3))
    now = se3.inverse(state.clones.T_world_imu)
    first = se3.inverse(state.clones.T_world_imu_first)
    p_imu = se3.apply(now[None], p_world[:, None])
    p_first = se3.apply(first[None], p_world[:, None])
    by_theta = so3.hat(p_first)
    for side, (camera, T_imu_cam) in enumerate(
        ((rig.cam0, rig.T_imu_cam0), (rig.cam1, rig.T_imu_cam1))
    ):
        T_cam_imu = se3.inverse(T_imu_cam)
        rows = slice(2 * side, 2 * side + 2)
        residual[..., rows] = pixels[..., rows] - camera.project(se3.apply(T_cam_imu, p_imu))
        _, J = camera.project_with_jacobian(se3.apply(T_cam_imu, p_first))
        J_imu = J @ T_cam_imu[:3, :3]
        J_world = J_imu @ first[None, :, :3, :3]
        J_pose[..., rows, :3] = J_imu @ by_theta
        J_pose[..., rows, 3:] = -J_world
        J_point[..., rows, :] = J_world
    ok = np.isfinite(residual) & np.isfinite(J_pose).all(-1)
    residual = np.where(ok, residual / sigma_px, 0.0)
    J_point = np.where(ok[..., None], J_point / sigma_px, 0.0)
    H = np.zeros((n_features, n_clones, 4, n_clones, 6))
    k = np.arange(n_clones)
    H[:, k, :, k, :] = np.moveaxis(np.where(ok[..., None], J_pose / sigma_px, 0.0), 1, 0)
    m = 4 * n_clones
    return FeatureSystem(
        H.reshape(n_features, m, 6 * n_clones),
        J_point.reshape(n_features, m, 3),
        residual.reshape(n_features, m),
        ok.sum((1, 2)),
    )


def project_nullspace(system: FeatureSystem) -> tuple[FloatArray, FloatArray]:
    """H_pose and residual without the point: (F, M - 3, 6K) and (F, M - 3).

    Three Householder reflections, on all features at once, bring H_point to triangular form; the
    rows below no longer depend on the point, and their noise stays white (G. Golub & C. Van Loan,
    sec. 5.2).
    """
    A = np.concatenate([system.H_point, system.H_pose, system.residual[..., None]], axis=2)
    for j in range(3):
        x = A[:, j:, j]
        v = x.copy()
        sign = np.where(x[:, 0] < 0.0, -1.0, 1.0)
        v[:, 0] += sign * np.linalg.norm(x, axis=1)
        length = (v * v).sum(1)
        v *= np.sqrt(2.0 / np.where(length > 0.0, length, 1.0))[:, None]
        A[:, j:] -= v[:, :, None] * (v[:, None, :] @ A[:, j:])
    return A[:, 3:, 3:-1], A[:, 3:, -1]


def chi2_gate(
    state: State, H: FloatArray, residual: FloatArray, dof: IntArray, multiplier: float
) -> BoolArray:
    """Which features (F,) agree with the state at 95 %: rᵀ (H P Hᵀ + I)⁻¹ r below the bound."""
    P = state.covariance[FIRST_CLONE:, FIRST_CLONE:]
    S = H @ P @ np.swapaxes(H, -1, -2) + np.eye(H.shape[1])
    distance = (residual * np.linalg.solve(S, residual[..., None])[..., 0]).sum(-1)
    bounds = np.array([chi2_bound(max(int(d), 1)) for d in dof])
    passed: BoolArray = (distance < multiplier * bounds) & (dof > 0)
    return passed
