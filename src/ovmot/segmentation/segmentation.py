"""Segmentation of the features in view into static, dynamic and unknown ones.

Points are judged by the predicted ego motion, before the filter's update, so that no dynamic point
can correct the pose by which it is judged.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.physics import WALKER_MPS
from ovmot.segmentation.motion_tests import MOTION_TESTS, Evidence, Verdict
from ovmot.segmentation.static_comparison import StaticComparison, compare_with_static
from ovmot.settings import SegmentationSettings
from ovmot.types import FrontendFrame, PointLabel, PoseWindow, ScenePoints


@dataclass(frozen=True, slots=True)
class Segmentation:
    """The points of a frame, and which of them (N,) an update should not use for now.

    `trusted` is False where the prediction itself is unsure of the rig's motion since the last
    frame: then no feature should be excluded for good. How many points move says nothing about
    that: in front of a lorry that fills the view, most of them do.
    """

    points: ScenePoints
    outlier: BoolArray
    trusted: bool


def segment_points(
    table: FeatureTable,
    history: StereoHistory,
    seen: FrontendFrame,
    window: PoseWindow,
    rig: StereoRig,
    settings: SegmentationSettings,
) -> Segmentation:
    """Label the N features of the newest frame as static, dynamic or unknown.

    `table` holds that frame as its last row, `history` its features in the order of `seen`,
    `window` the predicted poses of the clones. Judged are features with a stereo pair now and
    earlier that are within range both times; the others are unknown.
    """
    points, trusted = _unknown_points(seen, history, settings), prediction_is_sure(window)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero(points.p_cam0[:, 2] < settings.max_range_m)
    if not settings.enabled or len(history) == 0 or len(near) == 0:
        return Segmentation(points, ~seen.two_view_inlier, trusted)
    of_near = history.only(near)
    comparison = compare_with_static(of_near, window, rig)
    comparison = _within_range(comparison, settings.max_range_m)
    distance, reprojection = last_interval(comparison, of_near, rig, settings)
    evidence = Evidence(comparison, of_near.p_now, of_near.cov_now, distance, reprojection)
    verdict = MOTION_TESTS[settings.test](evidence, settings)
    if settings.candidates == "ransac":
        verdict = _only_rejected(verdict, seen.two_view_inlier[near])
    previous = table.pixels[history.row[-1], table.columns(of_near.feature_id), :2]
    points = replace(
        points,
        label=_put(points.label, near, _labels(verdict)),
        previous=_put(points.previous, near, previous),
        predicted=_put(points.predicted, near, rig.cam0.project(comparison.predicted[-1])),
        distance_m=_put(points.distance_m, near, distance),
        reprojection_px=_put(points.reprojection_px, near, reprojection),
    )
    off = verdict.moving | verdict.unclear
    outlier = _put(~seen.two_view_inlier, near[verdict.tested], off[verdict.tested])
    return Segmentation(points, outlier, trusted)


def prediction_is_sure(window: PoseWindow) -> bool:
    """Is the motion between the two newest poses known to half a walker's speed?"""
    if len(window.timestamp_ns) < 2:
        return False
    span_s = 1e-9 * float(window.timestamp_ns[-1] - window.timestamp_ns[-2])
    before, now = slice(-9, -6), slice(-3, None)  # positions of the two newest poses
    P = window.covariance
    relative = P[now, now] + P[before, before] - P[now, before] - P[before, now]
    sigma_m = np.sqrt(max(float(np.linalg.eigvalsh(relative)[-1]), 0.0))
    return bool(sigma_m < 0.5 * WALKER_MPS * span_s)


def last_interval(
    comparison: StaticComparison,
    history: StereoHistory,
    rig: StereoRig,
    settings: SegmentationSettings,
) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) in metres, depth weighted down, and reprojection error (N,) in pixels.

    Between the newest earlier frame and now; the reprojection error is measured in the undistorted
    normalized plane and is the worse of both cameras.
    """
    predicted = comparison.predicted[-1]
    weights = np.array([1.0, 1.0, settings.depth_weight])
    distance: FloatArray = np.linalg.norm((history.p_now - predicted) * weights, axis=-1)
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    off = (history.now - project_stereo(predicted, rig.T_cam1_cam0)[0]) * focal
    reprojection = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3]))
    return distance, reprojection


def _labels(verdict: Verdict) -> IntArray:
    label = np.full(len(verdict.tested), int(PointLabel.UNKNOWN), dtype=np.int64)
    label[verdict.tested & ~verdict.unclear] = int(PointLabel.STATIC)
    label[verdict.moving] = int(PointLabel.DYNAMIC)
    return label


def _within_range(comparison: StaticComparison, max_range: float) -> StaticComparison:
    """Only comparisons whose predicted point is within range too."""
    with np.errstate(invalid="ignore"):
        near = comparison.predicted[..., 2] < max_range
    return replace(comparison, residual=np.where(near[..., None], comparison.residual, np.nan))


def _only_rejected(verdict: Verdict, inlier: BoolArray) -> Verdict:
    """The original's candidates: a point that the two-view test accepted is static."""
    return Verdict(verdict.tested, verdict.moving & ~inlier, verdict.unclear & ~inlier)


def _unknown_points(
    seen: FrontendFrame, history: StereoHistory, settings: SegmentationSettings
) -> ScenePoints:
    """All points unknown, or static where the segmentation is switched off."""
    label = PointLabel.UNKNOWN if settings.enabled else PointLabel.STATIC
    n = len(seen)
    nothing = np.full((n, 2), np.nan)
    return ScenePoints(
        feature_id=seen.feature_id,
        pixels=seen.pixels,
        p_cam0=history.p_now,
        cov_cam0=history.cov_now,
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
