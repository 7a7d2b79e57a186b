"""Triangulation of one stereo pair, or of many views, batched over features.

Image points are normalized coordinates (undistorted, focal length 1); NaN where a view did not see
a feature.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray

MAX_DEPTH_M = 1e4
"""Stereo and views say nothing of what is farther: it is at infinity."""


def triangulate_stereo(normalized: FloatArray, T_cam1_cam0: FloatArray) -> FloatArray:
    """Points (..., 3) in the left camera, metres, from stereo pairs (..., 4).

    The point is on the left ray, at the depth that fits the right view best (least squares along
    the ray; R. Hartley & A. Zisserman, ch. 12, with an exact left view). NaN where the pair is
    incomplete or the point would lie behind a camera.
    """
    ray0 = np.concatenate([normalized[..., :2], np.ones_like(normalized[..., :1])], axis=-1)
    ray1 = ray0 @ T_cam1_cam0[:3, :3].T
    t = T_cam1_cam0[:3, 3]
    x1 = normalized[..., 2:]
    a = ray1[..., :2] - x1 * ray1[..., 2:]
    b = x1 * t[2] - t[:2]
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = (a * b).sum(-1) / (a * a).sum(-1)
        behind = ~((depth > 0.0) & (depth * ray1[..., 2] + t[2] > 0.0) & (depth < MAX_DEPTH_M))
    return np.where(behind[..., None], np.nan, ray0 * depth[..., None])


def project_normalized(points_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalized coordinates (..., 2) of camera points (..., 3), and the Jacobian (..., 2, 3)."""
    z = points_cam[..., 2]
    xy = points_cam[..., :2] / z[..., None]
    J = np.zeros((*xy.shape[:-1], 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = 1.0 / z
    J[..., 0, 2] = -xy[..., 0] / z
    J[..., 1, 2] = -xy[..., 1] / z
    return xy, J


def project_stereo(p_cam0: FloatArray, T_cam1_cam0: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both views (..., 4) of points (..., 3) in the left camera, and the Jacobian (..., 4, 3)."""
    xy0, J0 = project_normalized(p_cam0)
    xy1, J1 = project_normalized(se3.apply(T_cam1_cam0, p_cam0))
    J = np.concatenate([J0, J1 @ T_cam1_cam0[:3, :3]], axis=-2)
    return np.concatenate([xy0, xy1], axis=-1), J


def stereo_covariance(p_cam0: FloatArray, T_cam1_cam0: FloatArray, sigma: FloatArray) -> FloatArray:
    """Covariance (..., 3, 3), m², of points (..., 3) from `triangulate_stereo`, to first order.

    `sigma` (4,): standard deviations of the normalized coordinates, see
    `StereoRig.normalized_sigma`. The left error moves the ray, both errors move the depth along it
    by their components along the epipolar line. NaN where the point is NaN.
    """
    _, J = project_stereo(p_cam0, T_cam1_cam0)
    J1 = J[..., 2:, :]
    depth = p_cam0[..., 2, None, None]
    ray = p_cam0[..., None] / depth
    along = J1 @ ray  # derivative of the right view by the depth
    by_right = np.swapaxes(along, -1, -2) / (along * along).sum((-1, -2))[..., None, None]
    G = np.concatenate(
        [depth * (np.eye(3)[:, :2] - ray @ (by_right @ J1[..., :2])), ray @ by_right], axis=-1
    )
    G = G * sigma
    C: FloatArray = G @ np.swapaxes(G, -1, -2)
    return C


def inverse_3x3(matrix: FloatArray) -> FloatArray:
    """Inverses (..., 3, 3) by cofactors: fast on large batches, NaN or inf where singular."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrix, (-2, -1), (0, 1))
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    cofactors = np.empty_like(matrix)
    cofactors[..., 0, 0], cofactors[..., 1, 0], cofactors[..., 2, 0] = A, B, C
    cofactors[..., 0, 1], cofactors[..., 0, 2] = c * h - b * i, b * f - c * e
    cofactors[..., 1, 1], cofactors[..., 1, 2] = a * i - c * g, c * d - a * f
    cofactors[..., 2, 1], cofactors[..., 2, 2] = b * g - a * h, a * e - b * d
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse: FloatArray = cofactors / (a * A + b * B + c * C)[..., None, None]
    return inverse


def squared_distance(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared Mahalanobis distances eᵀ C⁻¹ e (...,) of errors (..., 3), covariances (..., 3, 3)."""
    weighted = (inverse_3x3(covariance) @ error[..., None])[..., 0]
    total: FloatArray = (error * weighted).sum(-1)
    return total


@dataclass(frozen=True, slots=True)
class ManyViewPoints:
    """Points (F, 3) in world, m, their depth (F,) in the first view that saw them, m, and which of
    them are valid (F,)."""

    p_world: FloatArray
    depth: FloatArray
    valid: BoolArray


def triangulate_many_views(
    normalized: FloatArray,
    T_view_world: FloatArray,
    sigma: float,
    *,
    depth_range: tuple[float, float] = (0.1, 500.0),
    iterations: int = 6,
) -> ManyViewPoints:
    """Points in world from F features seen in V views with known poses.

    `normalized` (F, V, 2), NaN where unseen; `T_view_world` (V, 4, 4); `sigma`: standard deviation
    of a normalized coordinate; `depth_range`: m. A linear solution is refined by
    Levenberg-Marquardt in (x/z, y/z, 1/z) of the first view that saw the feature (J. Montiel et
    al., RSS 2006). A point is valid with at least two views, its depth in range, and a root mean
    square error of at most 5 sigma.
    """
    seen = np.isfinite(normalized[..., 0])
    n_features = len(normalized)
    anchor = np.argmax(seen, axis=1)
    T_anchor_world = T_view_world[anchor]
    T_view_anchor = T_view_world[None] @ se3.inverse(T_anchor_world)[:, None]
    xy = np.where(seen[..., None], normalized, 0.0)
    weight = seen.astype(np.float64)

    p = _linear_point(xy, T_view_anchor, weight)
    z = np.where(p[:, 2] > depth_range[0], p[:, 2], depth_range[0])
    start = normalized[np.arange(n_features), anchor]
    state = np.concatenate([np.nan_to_num(start), 1.0 / z[:, None]], axis=1)
    state, mean_square = _refine_inverse_depth(state, xy, T_view_anchor, weight, iterations)

    depth = 1.0 / np.maximum(state[:, 2], 1.0 / MAX_DEPTH_M)
    p_anchor = np.concatenate([state[:, :2], np.ones((n_features, 1))], axis=1) * depth[:, None]
    p_world = se3.apply(se3.inverse(T_anchor_world), p_anchor)
    with np.errstate(invalid="ignore"):
        valid = (
            (seen.sum(1) >= 2)
            & (depth > depth_range[0])
            & (depth < depth_range[1])
            & (mean_square < (5.0 * sigma) ** 2)
        )
    return ManyViewPoints(p_world, depth, valid)


def _linear_point(xy: FloatArray, T: FloatArray, weight: FloatArray) -> FloatArray:
    """Least-squares points (F, 3) in the anchor frame from (R_01 - x R_2) p = x t_2 - t_01."""
    A = T[..., :2, :3] - xy[..., :, None] * T[..., 2:3, :3]
    b = xy * T[..., 2:3, 3] - T[..., :2, 3]
    A = A * weight[..., None, None]
    A, b = A.reshape(len(A), -1, 3), b.reshape(len(b), -1, 1)
    At = np.swapaxes(A, -1, -2)
    N, c = At @ A, (At @ b)[..., 0]
    N += 1e-9 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    p: FloatArray = (inverse_3x3(N) @ c[..., None])[..., 0]
    return p


def _refine_inverse_depth(
    state: FloatArray,
    xy: FloatArray,
    T: FloatArray,
    weight: FloatArray,
    iterations: int,
    *,
    tolerance: float = 1e-7,
) -> tuple[FloatArray, FloatArray]:
    """Levenberg-Marquardt on (alpha, beta, rho) (F, 3), each feature with its own damping.

    Until no step is larger than the `tolerance`, in normalized coordinates and 1/m.
    """
    count = np.maximum(weight.sum(1), 1.0)
    damping = np.full(len(state), 1e-4)
    cost, N, g = _inverse_depth_system(state, xy, T, weight)
    for _ in range(iterations):
        diagonal = np.einsum("fii->fi", N)[:, :, None] * np.eye(3)
        step = (inverse_3x3(N + damping[:, None, None] * diagonal) @ g[..., None])[..., 0]
        step = np.nan_to_num(step, posinf=0.0, neginf=0.0)
        trial = state + step
        trial[:, 2] = np.maximum(trial[:, 2], 1.0 / MAX_DEPTH_M)
        trial_cost, trial_N, trial_g = _inverse_depth_system(trial, xy, T, weight)
        better = trial_cost <= cost
        state = np.where(better[:, None], trial, state)
        N = np.where(better[:, None, None], trial_N, N)
        g = np.where(better[:, None], trial_g, g)
        cost = np.where(better, trial_cost, cost)
        damping = np.clip(np.where(better, damping * 0.1, damping * 10.0), 1e-9, 1e3)
        if np.abs(step).max(initial=0.0) < tolerance:
            break
    return state, cost / (2.0 * count)


def _inverse_depth_system(
    state: FloatArray, xy: FloatArray, T: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Squared error (F,), normal matrix (F, 3, 3) and gradient (F, 3) at (alpha, beta, rho)."""
    ray = np.concatenate([state[:, :2], np.ones((len(state), 1))], axis=1)
    h = (T[..., :3, :3] @ ray[:, None, :, None])[..., 0] + state[:, None, 2:] * T[..., :3, 3]
    behind = (h[..., 2] < 1e-6) & (weight > 0.0)
    h = np.where(behind[..., None], np.array([0.0, 0.0, 1.0]), h)
    predicted, J_normalized = project_normalized(h)
    columns = np.concatenate([T[..., :3, :2], T[..., :3, 3:]], axis=-1)
    J = J_normalized @ columns * weight[..., None, None]
    r = (xy - predicted) * weight[..., None]
    cost = (r * r).sum((1, 2)) + 1e3 * behind.sum(1)
    J, r = J.reshape(len(J), -1, 3), r.reshape(len(r), -1, 1)
    Jt = np.swapaxes(J, -1, -2)
    return cost, Jt @ J, (Jt @ r)[..., 0]
