"""Segmentation of the features in view into static, dynamic and unknown ones.

Points are judged by the predicted ego motion, before the filter's update, so that no dynamic point
can correct the pose by which it is judged.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.physics import WALKER_MPS
from ovmot.segmentation.motion_tests import MOTION_TESTS, Verdict, gather_evidence
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
    if not settings.enabled or len(history) == 0:
        return Segmentation(points, ~seen.two_view_inlier, trusted)
    evidence = gather_evidence(history, window, rig, settings)
    verdict = MOTION_TESTS[settings.test](evidence, settings)
    if settings.candidates == "ransac":
        verdict = _only_rejected(verdict, seen.two_view_inlier)
    near = evidence.p_cam0[:, 2] < settings.max_range_m
    previous = table.pixels[history.row[-1]].take(table.columns(history.feature_id), axis=0)[:, :2]
    previous[~near] = np.nan
    points = ScenePoints(
        feature_id=points.feature_id,
        pixels=points.pixels,
        p_cam0=points.p_cam0,
        cov_cam0=points.cov_cam0,
        label=_labels(verdict),
        track_id=points.track_id,
        previous=previous,
        predicted=rig.cam0.project(evidence.predicted),
        distance_m=evidence.distance_m,
        reprojection_px=evidence.reprojection_px,
        two_view_inlier=points.two_view_inlier,
    )
    off = verdict.moving | verdict.unclear
    outlier = np.where(verdict.tested, off, ~seen.two_view_inlier)
    return Segmentation(points, outlier, trusted)


def prediction_is_sure(window: PoseWindow) -> bool:
    """Is the motion between the two newest poses known to half a walker's speed?"""
    if len(window.timestamp_ns) < 2:
        return False
    span_s = 1e-9 * float(window.timestamp_ns[-1] - window.timestamp_ns[-2])
    before, now = slice(-9, -6), slice(-3, None)  # positions of the two newest poses
    P = window.covariance
    relative = P[now, now] + P[before, before] - P[now, before] - P[before, now]
    bound_m = 0.5 * WALKER_MPS * span_s
    return is_below(relative, bound_m**2)


def is_below(C: FloatArray, bound: float) -> bool:
    """Are all eigenvalues of a symmetric matrix (3, 3) below a bound?

    By the leading minors of the difference (Sylvester's criterion).
    """
    (a, b, c), (_, d, e), (_, _, f) = (bound * np.eye(3) - C).tolist()
    minor = a * d - b * b
    return bool(
        a > 0.0 and minor > 0.0 and f * minor + b * c * e * 2.0 - a * e * e - d * c * c > 0.0
    )


def _labels(verdict: Verdict) -> IntArray:
    label = np.full(len(verdict.tested), int(PointLabel.UNKNOWN), dtype=np.int64)
    label[verdict.tested & ~verdict.unclear] = int(PointLabel.STATIC)
    label[verdict.moving] = int(PointLabel.DYNAMIC)
    return label


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
