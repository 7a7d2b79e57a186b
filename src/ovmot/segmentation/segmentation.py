"""The split: which of the features in view move, by the predicted ego motion.

Candidates are judged before the filter's update, so that no moving point can correct the pose by
which it is judged.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.segmentation.motion_tests import MOTION_TESTS, Evidence, Verdict
from ovmot.segmentation.stereo_history import (
    Comparison,
    PatchDrift,
    StereoHistory,
    compare,
)
from ovmot.settings import SegmentationSettings
from ovmot.types import FrontendFrame, PointLabel, PoseWindow, ScenePoints

_TRUSTED_SPEED_MPS = 0.5  # half of what a walker does


@dataclass(frozen=True, slots=True)
class Segmentation:
    """The points of a frame, and which of them (N,) an update should not touch for now.

    `trusted` is False where the prediction itself is unsure of the rig's motion since the last
    frame: then no point should be written off for good. How many points move says nothing about
    that: before a lorry that fills the view, most of them do.
    """

    points: ScenePoints
    outlier: BoolArray
    trusted: bool


def segment_points(
    table: FeatureTable,
    seen: FrontendFrame,
    window: PoseWindow,
    rig: StereoRig,
    settings: SegmentationSettings,
) -> Segmentation:
    """Label the N features of the newest frame as static, dynamic or unknown.

    `table` holds that frame as its last row, `window` the predicted poses of its clones. Judged are
    features in stereo now and earlier, near enough both times; the others are unknown.
    """
    points, trusted = _unjudged(seen, rig, settings), prediction_is_sure(window)
    rows = _look_back_rows(table, window, settings.look_back_s)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero(points.p_cam0[:, 2] < settings.max_range_m)
    if not settings.enabled or len(rows) == 0 or len(near) == 0:
        return Segmentation(points, ~seen.two_view_inlier, trusted)
    column = table.columns(seen.feature_id[near])
    history = StereoHistory(
        then=table.normalized[rows][:, column],
        now=seen.normalized[near],
        clone_index=np.searchsorted(window.timestamp_ns, table.clone_ns[rows]),
        span_s=np.asarray((seen.timestamp_ns - table.frame_ns[rows]) * 1e-9, dtype=np.float64),
    )
    comparison = compare(
        history,
        window,
        rig,
        settings.pixel_sigma,
        PatchDrift(0.0, settings.drift_per_flow),
    )
    comparison = _within_range(comparison, settings.max_range_m)
    p_cam0, cov_cam0 = points.p_cam0[near], points.cov_cam0[near]
    distance, reprojection = last_interval(comparison, p_cam0, history.now, rig, settings)
    evidence = Evidence(comparison, p_cam0, cov_cam0, distance, reprojection)
    verdict = MOTION_TESTS[settings.test](evidence, settings)
    if settings.candidates == "ransac":
        verdict = _only_rejected(verdict, seen.two_view_inlier[near])
    points = replace(
        points,
        label=_put(points.label, near, _labels(verdict)),
        previous=_put(points.previous, near, table.pixels[rows[-1], column, :2]),
        predicted=_put(points.predicted, near, rig.cam0.project(comparison.predicted[-1])),
        distance_m=_put(points.distance_m, near, distance),
        reprojection_px=_put(points.reprojection_px, near, reprojection),
    )
    off = verdict.moving | verdict.unclear
    outlier = _put(~seen.two_view_inlier, near[verdict.tested], off[verdict.tested])
    return Segmentation(points, outlier, trusted)


def prediction_is_sure(window: PoseWindow) -> bool:
    """Is the motion between the two newest poses surer than what is to be told from it?"""
    if len(window.timestamp_ns) < 2:
        return False
    span_s = 1e-9 * float(window.timestamp_ns[-1] - window.timestamp_ns[-2])
    before, now = slice(-9, -6), slice(-3, None)  # positions of the two newest poses
    P = window.covariance
    relative = P[now, now] + P[before, before] - P[now, before] - P[before, now]
    sigma_m = np.sqrt(max(float(np.linalg.eigvalsh(relative)[-1]), 0.0))
    return bool(sigma_m < _TRUSTED_SPEED_MPS * span_s)


def _labels(verdict: Verdict) -> IntArray:
    label = np.full(len(verdict.tested), int(PointLabel.UNKNOWN), dtype=np.int64)
    label[verdict.tested & ~verdict.unclear] = int(PointLabel.STATIC)
    label[verdict.moving] = int(PointLabel.DYNAMIC)
    return label


def last_interval(
    comparison: Comparison,
    p_cam0: FloatArray,
    normalized: FloatArray,
    rig: StereoRig,
    settings: SegmentationSettings,
) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) in metres, depth weighted down, and reprojection error (N,) in pixels.

    Between the newest earlier row and now; the reprojection error is measured in the undistorted
    plane and is the worse of both cameras.
    """
    predicted = comparison.predicted[-1]
    weights = np.array([1.0, 1.0, settings.depth_weight])
    distance: FloatArray = np.linalg.norm((p_cam0 - predicted) * weights, axis=-1)
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    off = (normalized - project_stereo(predicted, rig.T_cam1_cam0)[0]) * focal
    reprojection = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3]))
    return distance, reprojection


def _look_back_rows(
    table: FeatureTable, window: PoseWindow, look_back_s: tuple[float, ...]
) -> IntArray:
    """Earlier rows to compare with, oldest first: near each look-back time, and the last."""
    posed = np.isin(table.clone_ns, window.timestamp_ns)
    posed[-1] = False
    rows = np.flatnonzero(posed)
    if len(rows) == 0:
        return rows
    age = (table.frame_ns[-1] - table.frame_ns[rows]) * 1e-9
    wanted = {int(rows[-1])}
    for span in look_back_s:
        near = int(np.argmin(np.abs(age - span)))
        if 0.5 * span < age[near] < 1.5 * span:
            wanted.add(int(rows[near]))
    return np.array(sorted(wanted), dtype=np.int64)


def _within_range(comparison: Comparison, max_range: float) -> Comparison:
    """Only comparisons whose carried point is near enough too."""
    with np.errstate(invalid="ignore"):
        near = comparison.predicted[..., 2] < max_range
    return replace(comparison, residual=np.where(near[..., None], comparison.residual, np.nan))


def _only_rejected(verdict: Verdict, inlier: BoolArray) -> Verdict:
    """The original's candidates: a point that the two-view test accepted is static."""
    return Verdict(verdict.tested, verdict.moving & ~inlier, verdict.unclear & ~inlier)


def _unjudged(seen: FrontendFrame, rig: StereoRig, settings: SegmentationSettings) -> ScenePoints:
    """All points unknown (nothing to compare with), or static where the split is switched off."""
    label = PointLabel.UNKNOWN if settings.enabled else PointLabel.STATIC
    n = len(seen)
    nothing = np.full((n, 2), np.nan)
    p_cam0 = triangulate_stereo(seen.normalized, rig.T_cam1_cam0)
    sigma = rig.normalized_sigma(settings.pixel_sigma)
    return ScenePoints(
        feature_id=seen.feature_id,
        pixels=seen.pixels,
        p_cam0=p_cam0,
        cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, sigma),
        label=np.full(n, int(label), dtype=np.int64),
        track_id=np.full(n, -1, dtype=np.int64),
        previous=nothing,
        predicted=nothing,
        distance_m=nothing[:, 0],
        reprojection_px=nothing[:, 0],
        two_view_inlier=seen.two_view_inlier,
    )


def _put(values: AnyArray, index: IntArray, new: AnyArray) -> AnyArray:
    """A copy of `values` with those at `index` replaced."""
    out = values.copy()
    out[index] = new
    return out
