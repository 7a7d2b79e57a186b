"""The initializer's bundle adjustment: all keyframes of its window at once.

Gauss-Newton on poses, velocities, biases, time offset and calibration (`window`), by preintegrated
IMU factors and priors (`factors`) and by the stereo reprojection of points, with a robust loss.
Points are triangulated anew at each step and leave the equations by their Schur complement
(B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1). The inverse of the information that is left
is the covariance with which the filter begins.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.stereo_motion import MIN_POINTS
from ovmot.geometry.triangulation import MAX_DEPTH_M, inverse_3x3
from ovmot.initialization.factors import Factor
from ovmot.initialization.window import (
    KEYFRAME_SIZE,
    OFFSET,
    KeyframeWindow,
    exposure_clones,
    exposure_poses,
    window_plus,
)
from ovmot.settings import FilterSettings
from ovmot.types import FrontendFrame
from ovmot.vio.msckf_features import DEPTH_RANGE_M, Reprojection, reproject
from ovmot.vio.online_calibration import calibrated_rig
from ovmot.vio.triangulation_kernel import triangulate_views_compiled

_NOTHING = np.empty(0)
_LOSS_SCALE = 1.5  # of the Geman-McClure loss, in units of the median error
NormalEquations = tuple[FloatArray, FloatArray]
"""JᵀJ (N, N) and -Jᵀr (N,) of whitened residuals."""


@dataclass(frozen=True, slots=True)
class AdjustedWindow:
    """The window after bundle adjustment, its covariance (N, N), and the root mean squares of the
    whitened residuals: `factor_rms` of the factors, `pixel_rms` of the images."""

    window: KeyframeWindow
    covariance: FloatArray
    factor_rms: float
    pixel_rms: float


def bundle_adjust(
    window: KeyframeWindow,
    factors: Callable[[KeyframeWindow], Sequence[Factor]],
    pixels: FloatArray,
    rig: StereoRig,
    settings: FilterSettings,
    *,
    offset_is_free: bool,
    considered: FloatArray = _NOTHING,
    max_iterations: int = 15,
    tolerance: float = 0.05,
) -> AdjustedWindow:
    """Adjust a window by points seen as `pixels` (F, K, 4), NaN where unseen.

    `factors` gives all factors beside the images; `rig`: that of the calibration files;
    `offset_is_free`: whether the time offset is estimated; `considered` (C,): prior variances of
    the calibration's last coordinates, which are not (`consider_covariance`). Steps end where their
    root mean square is below the `tolerance`, in standard deviations. Raises `InitializationError`
    where too few points can be triangulated, `LinAlgError` where the normal equations are singular.
    """
    free = np.ones(window.size, dtype=np.bool_)
    free[OFFSET] = offset_is_free
    known = slice(window.n_common - len(considered), window.n_common)
    free[known] = False
    for _ in range(max_iterations):
        N, b, _, _ = _normal_equations(window, factors, pixels, rig, settings)
        step = np.zeros(window.size)
        step[free] = np.linalg.solve(N[np.ix_(free, free)], b[free])
        window = window_plus(window, step)
        if float(step @ N @ step) < tolerance**2 * window.size:
            break
    N, _, factor_rms, pixel_rms = _normal_equations(window, factors, pixels, rig, settings)
    covariance = consider_covariance(N, free, known, considered)
    return AdjustedWindow(window, covariance, factor_rms, pixel_rms)


def consider_covariance(
    N: FloatArray, free: BoolArray, considered: slice, variance: FloatArray
) -> FloatArray:
    """Covariance (n, n) of an estimate of the coordinates `free` (n,) by normal equations N (n, n).

    The considered ones keep their prior `variance` (C,), but what they do to the estimate is in it:
    with S = -N_ff⁻¹ N_fc, P_ff = N_ff⁻¹ + S P_cc Sᵀ and P_fc = S P_cc (G. Bierman, "Factorization
    Methods for Discrete Sequential Estimation", 1977, ch. 8).
    """
    P, unknown = np.zeros_like(N), np.flatnonzero(free)
    P_ff = np.linalg.inv(N[np.ix_(unknown, unknown)])
    S = -P_ff @ N[unknown, considered]
    P[np.ix_(unknown, unknown)] = P_ff + (S * variance) @ S.T
    P[unknown, considered] = S * variance
    P[considered, unknown] = P[unknown, considered].T
    P[considered, considered] = np.diag(variance)
    return P


def _normal_equations(
    window: KeyframeWindow,
    factors: Callable[[KeyframeWindow], Sequence[Factor]],
    pixels: FloatArray,
    rig: StereoRig,
    settings: FilterSettings,
) -> tuple[FloatArray, FloatArray, float, float]:
    """JᵀJ, -Jᵀr, and the root mean squares of the factors' and the images' residuals."""
    N, b, square, rows = np.zeros((window.size, window.size)), np.zeros(window.size), 0.0, 0
    for r, J in factors(window):
        N, b = N + J.T @ J, b - J.T @ r
        square, rows = square + float(r @ r), rows + len(r)
    if not len(pixels):
        return N, b, np.sqrt(square / rows), 0.0
    points = reproject_points(window, pixels, rig, settings)
    if len(points.seen) < MIN_POINTS:
        raise InitializationError(
            f"{len(points.seen)} of {len(pixels)} points fit the window's poses"
            f" (at least {MIN_POINTS})"
        )
    points = robustly_weighted(points)
    N_images, b_images = schur_complement(window, points)
    pixel_rms = np.sqrt(float((points.residual**2).sum() / points.seen.sum()))
    return N + N_images, b + b_images, np.sqrt(square / rows), pixel_rms


def reproject_points(
    window: KeyframeWindow, pixels: FloatArray, rig: StereoRig, settings: FilterSettings
) -> Reprojection:
    """Reprojection of the points that can be triangulated by the window's poses.

    `pixels` (F, K, 4), NaN where unseen; `rig`: that of the calibration files.
    """
    calibrated = calibrated_rig(rig, window.calibration)
    clones = exposure_clones(window, window.imu_ns)
    T_imu_world = se3.inverse(clones.T_world_imu)
    cameras = (
        (calibrated.cam0, calibrated.T_imu_cam0, slice(0, 2)),
        (calibrated.cam1, calibrated.T_imu_cam1, slice(2, 4)),
    )
    T_views = np.concatenate([se3.inverse(T) @ T_imu_world for _, T, _ in cameras])
    views = [camera.normalize(pixels[..., side]) for camera, _, side in cameras]
    p_world, valid = triangulate_views_compiled(
        np.concatenate(views, axis=1), T_views, settings.pixel_sigma / calibrated.cam0.fx,
        np.array([*DEPTH_RANGE_M, MAX_DEPTH_M]),
    )  # fmt: skip
    p_world = p_world[valid]
    return reproject(
        clones, calibrated, pixels[valid], (p_world, p_world), settings.pixel_sigma,
        window.calibration,
    )  # fmt: skip


def robustly_weighted(points: Reprojection) -> Reprojection:
    """The same equations, each point weighted by the loss of S. Geman and D. McClure.

    A point is judged by all its views together, in units of the median error of the points: a car
    ahead fits any two frames, but not a third. Points up to the median error have weight 1.
    """
    rows = np.maximum(points.seen.sum((1, 2)) - 3, 1)
    error = (points.residual**2).sum((1, 2)) / rows
    median = max(float(np.median(error)), 1e-4)  # simulated pixels may be exact
    at_median = 1.0 + 1.0 / _LOSS_SCALE**2
    weight = np.minimum(at_median / (1.0 + error / (_LOSS_SCALE**2 * median)), 1.0)[:, None, None]
    return Reprojection(
        points.residual * weight, points.by_pose * weight[..., None],
        points.by_point * weight[..., None], points.by_calibration * weight[..., None], points.seen,
    )  # fmt: skip


def schur_complement(window: KeyframeWindow, points: Reprojection) -> NormalEquations:
    """JᵀJ and -Jᵀr of the images by the window, the points eliminated.

    Per point A = ∂h/∂point, J = ∂h/∂(common, pose of each view): JᵀJ - JᵀA (AᵀA)⁻¹ AᵀJ.
    """
    poses = exposure_poses(window)
    n, (n_points, n_views, _) = window.n_common, points.residual.shape
    by_common = points.by_pose @ poses.by_common
    by_common[..., OFFSET + 1 :] += points.by_calibration
    by_keyframe = points.by_pose @ poses.by_keyframe
    N, b = np.zeros((window.size, window.size)), np.zeros(window.size)
    flat = by_common.reshape(-1, n)
    N[:n, :n], b[:n] = flat.T @ flat, flat.T @ points.residual.ravel()
    W = np.zeros((n_points, 3, window.size))
    by_point = np.swapaxes(points.by_point, -1, -2)
    W[:, :, :n] = (by_point @ by_common).sum(1)
    W[:, :, n:] = np.moveaxis(by_point @ by_keyframe, 1, 2).reshape(n_points, 3, -1)
    for k in range(n_views):
        columns = window.columns(k)
        J = by_keyframe[:, k].reshape(-1, KEYFRAME_SIZE)
        N[columns, columns], b[columns] = J.T @ J, J.T @ points.residual[:, k].ravel()
        N[:n, columns] = by_common[:, k].reshape(-1, n).T @ J
        N[columns, :n] = N[:n, columns].T
    A = points.by_point.reshape(n_points, -1, 3)
    At = np.swapaxes(A, -1, -2)
    V_inverse = inverse_3x3(At @ A)
    g = At @ points.residual.reshape(n_points, -1, 1)
    K = (V_inverse @ W).reshape(-1, window.size)
    return N - W.reshape(-1, window.size).T @ K, b - K.T @ g.ravel()


def keyframe_pixels(
    frames: Sequence[FrontendFrame], feature_id: IntArray, *, max_features: int = 600
) -> FloatArray:
    """Pixels (F, K, 4), NaN where unseen, of those of the features that two frames or more have
    seen; at most `max_features`, the longest tracks first."""
    pixels = np.full((len(feature_id), len(frames), 4), np.nan)
    for k, frame in enumerate(frames):
        _, row, column = np.intersect1d(feature_id, frame.feature_id, return_indices=True)
        pixels[row, k] = frame.pixels[column]
    n_views = np.isfinite(pixels[..., ::2]).any(axis=-1).sum(axis=1)
    longest = np.argsort(-n_views, kind="stable")[:max_features]
    return np.asarray(pixels[longest[n_views[longest] > 1]])
