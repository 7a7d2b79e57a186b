"""The refinement of a start: all frames of its window at once, in place of one after another.

Gauss-Newton on poses, velocities, biases, time offset and calibration (`start_window`), from
pre-integrated IMU factors and priors (`start_factors`) and the stereo reprojection of points, with
a robust loss. Points are placed anew at each step and leave the equations by their Schur complement
(B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1). What information is left gives the
covariance with which the filter begins.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.triangulation import inverse_3x3, triangulate_many_views
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
from ovmot.vio.msckf_features import Reprojection, reproject
from ovmot.vio.online_calibration import calibrated_rig

_ITERATIONS = 15
_CONVERGED = 0.01  # standard deviations
_UNUSUAL = 1.5  # times the usual error, root mean square: such a point counts half
_MIN_POINTS = 8
_LEAST_ERROR = 1e-4  # variance of the pixels, where simulated ones are exact
Information = tuple[FloatArray, FloatArray]
"""JᵀJ (N, N) and -Jᵀr (N,) of whitened residuals."""


@dataclass(frozen=True, slots=True)
class AdjustedWindow:
    """The window at its best, its covariance (N, N), and the root mean squares of the whitened
    residuals: `factor_rms` of the factors, `pixel_rms` of the images."""

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
) -> AdjustedWindow:
    """Refine a window seen as `pixels` (F, K, 4), NaN where unseen; `rig` by the files.

    `factors` gives all that is known beside the images. Raises `LinAlgError` where the equations
    have no solution.
    """
    free = np.ones(window.size, dtype=np.bool_)
    free[OFFSET] = offset_is_free
    for _ in range(_ITERATIONS):
        N, b, _, _ = _normal_equations(window, factors, pixels, rig, settings)
        step = np.zeros(window.size)
        step[free] = np.linalg.solve(N[np.ix_(free, free)], b[free])
        window = window_plus(window, step)
        if float(step @ N @ step) < _CONVERGED**2 * window.size:
            break
    N, _, factor_rms, pixel_rms = _normal_equations(window, factors, pixels, rig, settings)
    covariance = np.zeros_like(N)
    covariance[np.ix_(free, free)] = np.linalg.inv(N[np.ix_(free, free)])
    return AdjustedWindow(window, covariance, factor_rms, pixel_rms)


def _normal_equations(
    window: KeyframeWindow,
    factors: Callable[[KeyframeWindow], Sequence[Factor]],
    pixels: FloatArray,
    rig: StereoRig,
    settings: FilterSettings,
) -> tuple[FloatArray, FloatArray, float, float]:
    """JᵀJ, -Jᵀr, and root mean squares of the factors' and the images' residuals."""
    N, b, square, rows = np.zeros((window.size, window.size)), np.zeros(window.size), 0.0, 0
    for r, J in factors(window):
        N, b = N + J.T @ J, b - J.T @ r
        square, rows = square + float(r @ r), rows + len(r)
    if not len(pixels):
        return N, b, np.sqrt(square / rows), 0.0
    placed = place_points(window, pixels, rig, settings)
    if len(placed.seen) < _MIN_POINTS:
        raise np.linalg.LinAlgError(
            f"{len(placed.seen)} of {len(pixels)} points fit the window's poses"
            f" (at least {_MIN_POINTS})"
        )
    seen = weighted(placed)
    N_images, b_images = image_information(window, seen)
    pixel_rms = np.sqrt(float((seen.residual**2).sum() / seen.seen.sum()))
    return N + N_images, b + b_images, np.sqrt(square / rows), pixel_rms


def place_points(
    window: KeyframeWindow, pixels: FloatArray, rig: StereoRig, settings: FilterSettings
) -> Reprojection:
    """Reprojection of the points (F', ) that can be placed by the window's poses."""
    now = calibrated_rig(rig, window.calibration)
    clones = exposure_clones(window, window.imu_ns)
    T_imu_world = se3.inverse(clones.T_world_imu)
    cameras = ((now.cam0, now.T_imu_cam0, 0), (now.cam1, now.T_imu_cam1, 2))
    T_views = np.concatenate([se3.inverse(T) @ T_imu_world for _, T, _ in cameras])
    plane = [camera.normalize(pixels[..., at : at + 2]) for camera, _, at in cameras]
    placed = triangulate_many_views(
        np.concatenate(plane, axis=1), T_views, settings.pixel_sigma / now.cam0.fx,
        depth_range=(settings.min_depth_m, settings.max_depth_m),
    )  # fmt: skip
    points = placed.p_world[placed.valid]
    return reproject(
        clones, now, pixels[placed.valid], (points, points), settings.pixel_sigma,
        window.calibration,
    )  # fmt: skip


def weighted(seen: Reprojection) -> Reprojection:
    """The same equations, each point weighed by the loss of S. Geman and D. McClure.

    A point is judged by all its views together, against the error that is usual among the points:
    a car ahead fits any two frames, but not a second.
    """
    rows = np.maximum(seen.seen.sum((1, 2)) - 3, 1)
    error = (seen.residual**2).sum((1, 2)) / rows
    usual = max(float(np.median(error)), _LEAST_ERROR)
    full = 1.0 + 1.0 / _UNUSUAL**2  # the usual point and better ones count in full
    root = np.minimum(full / (1.0 + error / (_UNUSUAL**2 * usual)), 1.0)[:, None, None]
    return Reprojection(
        seen.residual * root, seen.by_pose * root[..., None], seen.by_point * root[..., None],
        seen.by_calibration * root[..., None], seen.seen,
    )  # fmt: skip


def image_information(window: KeyframeWindow, seen: Reprojection) -> Information:
    """JᵀJ and -Jᵀr of the images by the window, without the points.

    Per point A = ∂h/∂point, J = ∂h/∂(common, pose of each view): JᵀJ - JᵀA (AᵀA)⁻¹ AᵀJ.
    """
    poses = exposure_poses(window)
    n, (n_points, n_views, _) = window.n_common, seen.residual.shape
    by_common = seen.by_pose @ poses.by_common
    by_common[..., OFFSET + 1 :] += seen.by_calibration
    by_keyframe = seen.by_pose @ poses.by_keyframe
    N, b = np.zeros((window.size, window.size)), np.zeros(window.size)
    flat = by_common.reshape(-1, n)
    N[:n, :n], b[:n] = flat.T @ flat, flat.T @ seen.residual.ravel()
    W = np.zeros((n_points, 3, window.size))
    by_point = np.swapaxes(seen.by_point, -1, -2)
    W[:, :, :n] = (by_point @ by_common).sum(1)
    W[:, :, n:] = np.moveaxis(by_point @ by_keyframe, 1, 2).reshape(n_points, 3, -1)
    for k in range(n_views):
        here = window.columns(k)
        J = by_keyframe[:, k].reshape(-1, KEYFRAME_SIZE)
        N[here, here], b[here] = J.T @ J, J.T @ seen.residual[:, k].ravel()
        N[:n, here] = by_common[:, k].reshape(-1, n).T @ J
        N[here, :n] = N[:n, here].T
    A = seen.by_point.reshape(n_points, -1, 3)
    At = np.swapaxes(A, -1, -2)
    V_inverse = inverse_3x3(At @ A)
    g = At @ seen.residual.reshape(n_points, -1, 1)
    K = (V_inverse @ W).reshape(-1, window.size)
    return N - W.reshape(-1, window.size).T @ K, b - K.T @ g.ravel()


def window_pixels(
    frames: Sequence[FrontendFrame], feature_id: IntArray, max_features: int
) -> FloatArray:
    """Pixels (F, K, 4) of those of the features that were seen more than once, longest first."""
    out = np.full((len(feature_id), len(frames), 4), np.nan)
    for k, frame in enumerate(frames):
        _, a, b = np.intersect1d(feature_id, frame.feature_id, return_indices=True)
        out[a, k] = frame.pixels[b]
    views = np.isfinite(out[..., ::2]).any(axis=-1).sum(axis=1)
    longest = np.argsort(-views, kind="stable")[:max_features]
    return np.asarray(out[longest[views[longest] > 1]])
