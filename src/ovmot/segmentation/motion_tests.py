"""Is a point dynamic? The covariance-scaled test and the fixed thresholds.

Both take the `Evidence` of a frame and answer per feature; neither knows of tracks or images. A
further test is one more function and a line in `MOTION_TESTS`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.physics import ACCEL_SIGMA_MPS2, CAR_SIZE_M, TURN_SPREAD_MPS, VARIANCE_FACTOR, gate
from ovmot.segmentation.comparison_kernel import compare_with_rest_compiled
from ovmot.segmentation.neighbour_kernel import count_alike_compiled
from ovmot.segmentation.static_comparison import ego_motion_since, pairs_of, stereo_noise
from ovmot.settings import SegmentationSettings
from ovmot.types import PoseWindow

_UNLIKELY = 0.99  # probability that a point at rest stays below


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of N points, positions in the present left camera, SI.

    `p_cam0` (N, 3): positions now, with covariance `cov_cam0` (N, 3, 3). `rows` (N,): number of
    earlier frames that were compared; `distance` (N,): the largest squared Mahalanobis distance
    from rest over them, 4 degrees of freedom, 0 where rest is likely. One `velocity` (N, 3) in m/s
    that fits them all, its `covariance` (N, 3, 3), and whether it explains what was seen,
    `explained` (N,): NaN and False where rest is likely. Over the last interval, where it was
    compared, `in_last` (N,): where the point would be at rest, `predicted` (N, 3), the weighted
    distance from there, `distance_m` (N,), and the reprojection error `reprojection_px` (N,).
    """

    p_cam0: FloatArray
    cov_cam0: FloatArray
    distance: FloatArray
    rows: IntArray
    velocity: FloatArray
    covariance: FloatArray
    explained: BoolArray
    in_last: BoolArray
    predicted: FloatArray
    distance_m: FloatArray
    reprojection_px: FloatArray


@dataclass(frozen=True, slots=True)
class Verdict:
    """Per feature (N,): tested at all, moves, or is neither clearly at rest nor in motion."""

    tested: BoolArray
    moving: BoolArray
    unclear: BoolArray


MotionTest = Callable[[Evidence, SegmentationSettings], Verdict]


def gather_evidence(
    history: StereoHistory, window: PoseWindow, rig: StereoRig, settings: SegmentationSettings
) -> Evidence:
    """The points of a history against rest, by the ego motion of the window.

    Compared are points within range, now and where they are predicted.
    """
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    noise = stereo_noise(history, history.noise.single_px, rig)
    found = compare_with_rest_compiled(
        pairs_of(history), ego_motion_since(history, window, rig), noise,
        settings.max_range_m, settings.forgiven_speed_mps, ACCEL_SIGMA_MPS2, gate(4, _UNLIKELY),
        settings.depth_weight, focal,
    )  # fmt: skip
    bound = VARIANCE_FACTOR * velocity_gates(len(history))
    return Evidence(
        p_cam0=history.p_now,
        cov_cam0=history.cov_now,
        distance=found.distance,
        rows=found.rows,
        velocity=found.velocity,
        covariance=found.covariance,
        explained=found.cost < bound[found.rows],
        in_last=found.in_last,
        predicted=found.predicted,
        distance_m=found.distance_m,
        reprojection_px=found.reprojection,
    )


def velocity_gates(n_rows: int) -> FloatArray:
    """Bounds (L + 1,) of the cost of one velocity that explains 0 to L stereo pairs."""
    return np.array([gate(max(4 * m - 3, 1), 0.999) for m in range(n_rows + 1)])


def covariance_test(evidence: Evidence, settings: SegmentationSettings) -> Verdict:
    """Chi-squared test of rest, then of one common velocity with the neighbours.

    A point moves when rest is out of the question, a single velocity explains all its earlier
    positions, and a neighbour moves likewise; or when rest is unlikely and two neighbours surely
    move likewise. One earlier position is explained by any velocity: it must tell as much as two,
    and two neighbours must share it. Where rest is out of the question without that, a wrong match
    is as likely as a motion: unclear.
    """
    tested, rows, distance = evidence.rows > 0, evidence.rows, evidence.distance
    false_alarm = settings.false_alarm
    impossible = tested & (distance > gate(4, 1.0 - false_alarm))
    unlikely = tested & (distance > gate(4, _UNLIKELY))
    steady = evidence.explained & (rows >= 2)
    strong, weak = impossible & steady, unlikely & steady
    certain = distance > gate(4, 1.0 - false_alarm**2)
    fresh = certain & evidence.explained & (rows == 1)
    candidates = weak | fresh
    alike, alike_strong, alike_both = count_alike_compiled(
        evidence.p_cam0, evidence.cov_cam0, evidence.velocity, evidence.covariance,
        np.flatnonzero(candidates), np.column_stack([candidates, strong, strong | fresh]),
        0.5 * CAR_SIZE_M[0], TURN_SPREAD_MPS, gate(3, 0.99),
    ).T  # fmt: skip
    moving = (strong & (alike > 0)) | (weak & (alike_strong >= 2)) | (fresh & (alike_both >= 2))
    return Verdict(tested, moving, impossible & ~moving)


def fixed_test(evidence: Evidence, settings: SegmentationSettings) -> Verdict:
    """The original's thresholds on the last interval: weighted 3-D distance and reprojection."""
    tested = evidence.in_last
    with np.errstate(invalid="ignore"):
        far = evidence.distance_m > settings.distance_threshold_m
        off = evidence.reprojection_px > settings.reprojection_threshold_px
    moves = far | off if settings.combine == "any" else far & off
    return Verdict(tested, tested & moves, np.zeros_like(tested))


MOTION_TESTS: dict[str, MotionTest] = {"covariance": covariance_test, "fixed": fixed_test}
