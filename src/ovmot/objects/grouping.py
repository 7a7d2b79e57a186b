"""Groups of points that are near each other and move alike: the candidates for rigid bodies."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import chdtri

from ovmot.cameras.rig import StereoRig
from ovmot.config import ObjectSettings
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import stereo_covariance
from ovmot.objects.comparison import Comparison, StereoHistory, compare, plane_sigma
from ovmot.objects.motion_tests import fit_velocity
from ovmot.tracks import TrackTable
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_REACH_SIGMAS = 2.0  # along the ray, on top of the radius
_SPEED_SPREAD = 0.5  # m/s by which points of one turning body may differ
_MOVES = 7.81  # 95 % of the same: less tells no motion
_FIT_SLACK = 2.0  # on the bound of the constant-velocity fit, for patches that slide


@dataclass(frozen=True, slots=True)
class MotionHistory:
    """M points that may move, over L earlier rows and now.

    `feature_id` (M,), `hops` (L,): frames since. `history` holds the plane coordinates,
    `comparison` where the ego motion alone would put the points, `p_cam0` (M, 3) and `cov_cam0` (M, 3, 3) where they
    are. `velocity` (M, 3) and `velocity_cov` (M, 3, 3): over all rows, in the camera's axes.
    """

    feature_id: IntArray
    hops: IntArray
    history: StereoHistory
    comparison: Comparison
    p_cam0: FloatArray
    cov_cam0: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray


def motion_history(
    table: TrackTable,
    points: ScenePoints,
    window: PoseWindow,
    rig: StereoRig,
    settings: ObjectSettings,
) -> MotionHistory | None:
    """What the table knows of all points that are not static; None where that is nothing."""
    rows = _rows(table, window, settings.look_back_s)
    candidate = (points.label != int(PointLabel.STATIC)) & np.isfinite(points.p_cam0[:, 2])
    feature_id = points.feature_id[candidate]
    if len(rows) == 0 or len(feature_id) < settings.min_points:
        return None
    order = np.argsort(table.feature_id)
    column = order[np.searchsorted(table.feature_id, feature_id, sorter=order)]
    ever = np.isfinite(table.normalized[rows][:, column]).all(-1).any(0)
    if ever.sum() < settings.min_points:
        return None
    feature_id, column = feature_id[ever], column[ever]
    history = StereoHistory(
        then=table.normalized[rows][:, column],
        now=table.normalized[-1, column],
        clone_index=np.searchsorted(window.timestamp_ns, table.clone_ns[rows]),
        span_s=np.asarray((table.frame_ns[-1] - table.frame_ns[rows]) * 1e-9, dtype=np.float64),
    )
    comparison = compare(history, window, rig, settings.pixel_sigma, settings.slide_per_flow)
    W = np.linalg.inv(_with_acceleration(comparison, settings.accel_sigma_mps2))
    W = np.where(comparison.tested[..., None, None], W, 0.0)
    velocity, covariance, cost = fit_velocity(comparison, W)
    steady = cost < _FIT_SLACK * chdtri(np.maximum(4 * comparison.tested.sum(0) - 3, 1), 0.001)
    distance = (velocity * np.linalg.solve(covariance, velocity[..., None])[..., 0]).sum(-1)
    kept = np.flatnonzero(steady & (distance > _MOVES))
    p_cam0 = points.p_cam0[candidate][ever][kept]
    sigma = plane_sigma(rig, settings.pixel_sigma)
    return MotionHistory(
        feature_id=feature_id[kept],
        hops=len(table.frame_ns) - 1 - rows,
        history=replace(history, then=history.then[:, kept], now=history.now[kept]),
        comparison=_only(comparison, kept),
        p_cam0=p_cam0,
        cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, sigma),
        velocity=velocity[kept],
        velocity_cov=covariance[kept],
    )


def _only(comparison: Comparison, index: IntArray) -> Comparison:
    """The comparison of some points."""
    return Comparison(
        comparison.span_s,
        comparison.predicted[:, index],
        comparison.residual[:, index],
        comparison.J[:, index],
        comparison.J_motion[:, index],
        comparison.S[:, index],
    )


def _with_acceleration(comparison: Comparison, accel_sigma: float) -> FloatArray:
    """Covariance (L, N, 4, 4) of residuals when the velocity may change on the way."""
    tested = comparison.tested[..., None, None]
    J = np.where(tested, comparison.J, 0.0)
    S = np.where(tested, comparison.S, np.eye(4))
    slack = (0.5 * accel_sigma * comparison.span_s**2) ** 2
    return S + J @ np.swapaxes(J, -1, -2) * slack[:, None, None, None]


def _rows(table: TrackTable, window: PoseWindow, look_back_s: tuple[float, ...]) -> IntArray:
    """Earlier rows with a pose near each look-back time, oldest first."""
    posed = np.isin(table.clone_ns, window.timestamp_ns)
    posed[-1] = False
    rows = np.flatnonzero(posed)
    if len(rows) == 0:
        return rows
    age = (table.frame_ns[-1] - table.frame_ns[rows]) * 1e-9
    apart = np.abs(age[None] - np.array(look_back_s)[:, None])
    nearest = apart.argmin(1)
    near = apart.min(1) < 0.3 * np.array(look_back_s)
    return np.unique(rows[nearest[near]])


def group_points(points: MotionHistory, settings: ObjectSettings) -> tuple[IntArray, ...]:
    """Indices of the points of each connected component of like movers, largest first."""
    pairs = _near_pairs(points.p_cam0, points.cov_cam0, settings.neighbour_radius_m)
    pairs = pairs[_same_velocity(points, pairs)]
    n = len(points.feature_id)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, component = connected_components(graph, directed=False)
    size = np.bincount(component)
    large = np.flatnonzero(size >= settings.min_points)
    by_size = large[np.argsort(-size[large], kind="stable")]
    return tuple(np.flatnonzero(component == k) for k in by_size)


def _near_pairs(p_cam0: FloatArray, cov_cam0: FloatArray, radius: float) -> IntArray:
    """Pairs (P, 2) of points within `radius` across the rays, farther along them.

    Along the ray, stereo scatters by s z², so that the reach there is r + k s z². In the depth
    u(z) = ∫ r dz / (r + k s z²) = sqrt(r / k s) atan(z sqrt(k s / r)) that reach is r everywhere.
    """
    z = p_cam0[:, 2]
    # Two points scatter: √2 of one.
    ks = _REACH_SIGMAS * np.sqrt(2.0) * float(np.median(np.sqrt(cov_cam0[:, 2, 2]) / z**2))
    u = np.sqrt(radius / ks) * np.arctan(z * np.sqrt(ks / radius))
    tree = cKDTree(np.column_stack([p_cam0[:, :2], u]))
    return np.asarray(tree.query_pairs(radius, output_type="ndarray"), np.int64).reshape(-1, 2)


def _same_velocity(points: MotionHistory, pairs: IntArray) -> BoolArray:
    """Which pairs (P,) have velocities that agree within their covariance."""
    a, b = pairs[:, 0], pairs[:, 1]
    dv = points.velocity[a] - points.velocity[b]
    C = points.velocity_cov[a] + points.velocity_cov[b] + _SPEED_SPREAD**2 * np.eye(3)
    distance = (dv * np.linalg.solve(C, dv[..., None])[..., 0]).sum(-1)
    agrees: BoolArray = distance < _GATE
    return agrees
