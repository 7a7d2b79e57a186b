"""Groups of points that are near each other and move alike: the candidates for rigid bodies."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ovmot.cameras.rig import StereoRig
from ovmot.config import ObjectSettings
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import stereo_covariance, triangulate_stereo
from ovmot.objects.comparison import Comparison, StereoHistory, compare, plane_sigma
from ovmot.objects.motion_tests import fit_velocity
from ovmot.tracks import TrackTable
from ovmot.types import PointLabel, PoseWindow, ScenePoints

_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_REACH_SIGMAS = 2.0  # along the ray, on top of the radius
_SPEED_SPREAD = 0.5  # m/s by which points of one turning body may differ
_NEIGHBOURS_OF_DOUBTFUL = 2  # moving ones that a doubtful point must agree with


@dataclass(frozen=True, slots=True)
class MotionHistory:
    """M points that may move, over L earlier rows and now.

    `feature_id` (M,), `certain` (M,): labelled dynamic. `rows` (L,) of the table, `clone` (L,) of
    the window, `hops` (L,) frames since. `history` holds the plane coordinates, `comparison` where
    the ego motion alone would put the points, `p_cam0` (M, 3) and `cov_cam0` (M, 3, 3) where they
    are. `velocity` (M, 3) and `velocity_cov` (M, 3, 3): over all rows, in the camera's axes.
    """

    feature_id: IntArray
    certain: BoolArray
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
    certain = points.label[candidate] == int(PointLabel.DYNAMIC)
    if len(rows) == 0 or certain.sum() < settings.min_points:
        return None
    order = np.argsort(table.feature_id)
    column = order[np.searchsorted(table.feature_id, feature_id, sorter=order)]
    then = table.normalized[rows][:, column]
    ever = np.isfinite(then).all(-1).any(0)
    history = StereoHistory(
        then=then[:, ever],
        now=table.normalized[-1, column[ever]],
        clone_index=np.searchsorted(window.timestamp_ns, table.clone_ns[rows]),
        span_s=np.asarray((table.frame_ns[-1] - table.frame_ns[rows]) * 1e-9, dtype=np.float64),
    )
    comparison = compare(history, window, rig, settings.pixel_sigma, settings.slide_per_flow)
    W = np.linalg.inv(_with_acceleration(comparison, settings.accel_sigma_mps2))
    W = np.where(comparison.tested[..., None, None], W, 0.0)
    velocity, covariance, _ = fit_velocity(comparison, W)
    p_cam0 = triangulate_stereo(history.now, rig.T_cam1_cam0)
    sigma = plane_sigma(rig, settings.pixel_sigma)
    return MotionHistory(
        feature_id=feature_id[ever],
        certain=certain[ever],
        hops=len(table.frame_ns) - 1 - rows,
        history=history,
        comparison=comparison,
        p_cam0=p_cam0,
        cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, sigma),
        velocity=velocity,
        velocity_cov=covariance,
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
    """Indices of the points of each connected component of like movers, largest first.

    Doubtful points join where they agree with two moving ones, but never connect others.
    """
    pairs = _near_pairs(points.p_cam0, points.cov_cam0, settings.neighbour_radius_m)
    pairs = pairs[_same_velocity(points, pairs)]
    n, certain = len(points.feature_id), points.certain
    moving = pairs[certain[pairs].all(1)]
    a, b = moving[:, 0], moving[:, 1]
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    _, component = connected_components(graph, directed=False)
    component = np.asarray(component, dtype=np.int64)

    mixed = pairs[certain[pairs].sum(1) == 1]
    doubtful = np.where(certain[mixed[:, 0]], mixed[:, 1], mixed[:, 0])
    mover = mixed.sum(1) - doubtful
    enough = np.bincount(doubtful, minlength=n) >= _NEIGHBOURS_OF_DOUBTFUL
    component[doubtful[enough[doubtful]]] = component[mover[enough[doubtful]]]
    groups = [np.flatnonzero(component == k) for k in np.unique(component[certain])]
    groups = [g for g in groups if len(g) >= settings.min_points]
    return tuple(sorted(groups, key=len, reverse=True))


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
