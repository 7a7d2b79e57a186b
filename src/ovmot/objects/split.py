"""The split: which of the features in view move, by the predicted ego motion.

Candidates are judged before the filter's update, so that no moving point can correct the pose by
which it is judged.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import SplitSettings
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.objects.comparison import Comparison, StereoHistory, compare, plane_sigma
from ovmot.objects.motion_tests import MOTION_TESTS, Evidence, Verdict
from ovmot.tracks import TrackTable
from ovmot.types import FrontendFrame, PointLabel, PoseWindow, ScenePoints

LOOK_BACK_S = (1.5, 0.8, 0.3)  # and always the last frame


@dataclass(frozen=True, slots=True)
class Split:
    """The points of a frame, and which of them (N,) an update should not touch for now."""

    points: ScenePoints
    suspect: BoolArray


def split_points(
    table: TrackTable,
    seen: FrontendFrame,
    window: PoseWindow,
    rig: StereoRig,
    settings: SplitSettings,
) -> Split:
    """Label the N features of the newest frame as static, dynamic or unknown.

    `table` holds that frame as its last row, `window` the predicted poses of its clones.
    """
    column = _columns_of(table, seen.feature_id)
    p_cam0 = triangulate_stereo(seen.normalized, rig.T_cam1_cam0)
    sigma = plane_sigma(rig, settings.pixel_sigma)
    cov_cam0 = stereo_covariance(p_cam0, rig.T_cam1_cam0, sigma)
    rows = _look_back_rows(table, window) if settings.enabled else np.empty(0, dtype=np.int64)
    if len(rows) == 0:
        return _unjudged(seen, p_cam0, cov_cam0, settings)
    history = StereoHistory(
        then=table.normalized[rows][:, column],
        now=seen.normalized,
        clone_index=np.searchsorted(window.timestamp_ns, table.clone_ns[rows]),
        span_s=np.asarray((seen.timestamp_ns - table.frame_ns[rows]) * 1e-9, dtype=np.float64),
    )
    comparison = compare(history, window, rig, settings.pixel_sigma, settings.drift_per_flow)
    comparison = _within_range(comparison, p_cam0, settings.max_range_m)
    distance, reprojection = last_interval(comparison, p_cam0, seen, rig, settings)
    evidence = Evidence(comparison, p_cam0, cov_cam0, distance, reprojection)
    verdict = MOTION_TESTS[settings.test](evidence, settings)
    if settings.candidates == "ransac":
        verdict = _only_rejected(verdict, seen.two_view_inlier)
    label = np.full(len(seen), int(PointLabel.UNKNOWN), dtype=np.int64)
    label[verdict.tested & ~verdict.unclear] = int(PointLabel.STATIC)
    label[verdict.moving] = int(PointLabel.DYNAMIC)
    points = ScenePoints(
        feature_id=seen.feature_id,
        pixels=seen.pixels,
        p_cam0=p_cam0,
        cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, plane_sigma(rig, settings.pixel_sigma)),
        label=label,
        track_id=np.full(len(seen), -1, dtype=np.int64),
        previous=table.pixels[rows[-1], column, :2],
        predicted=rig.cam0.project(comparison.predicted[-1]),
        distance_m=distance,
        reprojection_px=reprojection,
        two_view_inlier=seen.two_view_inlier,
    )
    suspect = verdict.moving | verdict.unclear | (~seen.two_view_inlier & ~verdict.tested)
    return Split(points, suspect)


def last_interval(
    comparison: Comparison,
    p_cam0: FloatArray,
    seen: FrontendFrame,
    rig: StereoRig,
    settings: SplitSettings,
) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) in metres, depth weighted down, and reprojection error (N,) in pixels.

    Between the newest earlier row and now; the reprojection error is measured in the undistorted
    plane and is the worse of both cameras.
    """
    predicted = comparison.predicted[-1]
    weights = np.array([1.0, 1.0, settings.depth_weight])
    distance: FloatArray = np.linalg.norm((p_cam0 - predicted) * weights, axis=-1)
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    off = (seen.normalized - project_stereo(predicted, rig.T_cam1_cam0)[0]) * focal
    reprojection = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3]))
    return distance, reprojection


def _look_back_rows(table: TrackTable, window: PoseWindow) -> IntArray:
    """Earlier rows to compare with, oldest first: near each look-back time, and the last."""
    posed = np.isin(table.clone_ns, window.timestamp_ns)
    posed[-1] = False
    rows = np.flatnonzero(posed)
    if len(rows) == 0:
        return rows
    age = (table.frame_ns[-1] - table.frame_ns[rows]) * 1e-9
    wanted = {int(rows[-1])}
    for span in LOOK_BACK_S:
        near = int(np.argmin(np.abs(age - span)))
        if 0.5 * span < age[near] < 1.5 * span:
            wanted.add(int(rows[near]))
    return np.array(sorted(wanted), dtype=np.int64)


def _columns_of(table: TrackTable, feature_id: IntArray) -> IntArray:
    order = np.argsort(table.feature_id)
    return order[np.searchsorted(table.feature_id, feature_id, sorter=order)]


def _within_range(comparison: Comparison, p_cam0: FloatArray, max_range: float) -> Comparison:
    """Only comparisons whose point is in front of both cameras and near enough, then and now."""
    with np.errstate(invalid="ignore"):
        near = (p_cam0[:, 2] < max_range) & (comparison.predicted[..., 2] < max_range)
    return replace(comparison, residual=np.where(near[..., None], comparison.residual, np.nan))


def _only_rejected(verdict: Verdict, inlier: BoolArray) -> Verdict:
    """The original's candidates: a point that the two-view test accepted is static."""
    return Verdict(verdict.tested, verdict.moving & ~inlier, verdict.unclear & ~inlier)


def _unjudged(
    seen: FrontendFrame, p_cam0: FloatArray, cov_cam0: FloatArray, settings: SplitSettings
) -> Split:
    """All points unknown (nothing to compare with), or static where the split is switched off."""
    label = PointLabel.UNKNOWN if settings.enabled else PointLabel.STATIC
    n = len(seen)
    nothing = np.full((n, 2), np.nan)
    points = ScenePoints(
        feature_id=seen.feature_id,
        pixels=seen.pixels,
        p_cam0=p_cam0,
        cov_cam0=cov_cam0,
        label=np.full(n, int(label), dtype=np.int64),
        track_id=np.full(n, -1, dtype=np.int64),
        previous=nothing,
        predicted=nothing,
        distance_m=nothing[:, 0],
        reprojection_px=nothing[:, 0],
        two_view_inlier=seen.two_view_inlier,
    )
    return Split(points, np.zeros(n, dtype=np.bool_))
