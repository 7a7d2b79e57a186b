"""Is a point dynamic? The covariance-scaled test and the fixed thresholds.

Both take the `Evidence` of a frame and answer per feature; neither knows of tracks or images. A
further test is one more function and a line in `MOTION_TESTS`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.physics import ACCEL_SIGMA_MPS2, VARIANCE_FACTOR, gate, gates
from ovmot.segmentation.history_kernel import fit_velocities_compiled
from ovmot.segmentation.neighbour_consensus import neighbours_with_same_velocity
from ovmot.segmentation.static_comparison import StaticComparison
from ovmot.settings import SegmentationSettings


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of N points: the comparisons, positions now (N, 3) in the left camera with
    covariance (N, 3, 3), and over the last interval the weighted distance (N,) in metres and the
    reprojection error (N,) in pixels."""

    comparison: StaticComparison
    p_cam0: FloatArray
    cov_cam0: FloatArray
    distance_m: FloatArray
    reprojection_px: FloatArray


@dataclass(frozen=True, slots=True)
class Verdict:
    """Per feature (N,): tested at all, moves, or is neither clearly at rest nor in motion."""

    tested: BoolArray
    moving: BoolArray
    unclear: BoolArray


@dataclass(frozen=True, slots=True)
class StaticTest:
    """Of N points: the largest squared distance from rest over the earlier rows (N,), the number
    of rows compared (N,), one velocity (N, 3) in m/s in the camera's axes that fits them all, its
    covariance (N, 3, 3), and whether it explains what was seen (N,)."""

    distance: FloatArray
    rows: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    explained: BoolArray


MotionTest = Callable[[Evidence, SegmentationSettings], Verdict]


def covariance_test(evidence: Evidence, settings: SegmentationSettings) -> Verdict:
    """Chi-squared test of rest, then of one common velocity with the neighbours.

    A point moves when rest is out of the question, a single velocity explains all its earlier
    positions, and a neighbour moves likewise; or when rest is unlikely and two neighbours surely
    move likewise. One earlier position is explained by any velocity: it must tell as much as two,
    and two neighbours must share it. Where rest is out of the question without that, a wrong match
    is as likely as a motion: unclear.
    """
    static = examine_static(evidence.comparison, settings)
    tested = static.rows > 0
    false_alarm = settings.false_alarm
    impossible = tested & (static.distance > gate(4, 1.0 - false_alarm))
    unlikely = tested & (static.distance > gate(4, 0.99))
    steady = static.explained & (static.rows >= 2)
    strong, weak = impossible & steady, unlikely & steady
    certain = static.distance > gate(4, 1.0 - false_alarm**2)
    fresh = certain & static.explained & (static.rows == 1)
    alike = neighbours_with_same_velocity(
        evidence.p_cam0, evidence.cov_cam0, static.velocity, static.covariance, weak | fresh
    )
    any_neighbour = alike.any(axis=1)
    by_strong = (alike & strong[None, :]).sum(axis=1) >= 2
    by_both = (alike & (strong | fresh)[None, :]).sum(axis=1) >= 2
    moving = (strong & any_neighbour) | (weak & by_strong) | (fresh & by_both)
    return Verdict(tested, moving, impossible & ~moving)


def examine_static(comparison: StaticComparison, settings: SegmentationSettings) -> StaticTest:
    """Squared distances from rest, and the velocity that fits all earlier rows best.

    Under rest r ~ N(0, S + J Jᵀ (s Δt)²), where s forgives slow drifts of the ego motion; under
    motion r = J v Δt with v by weighted least squares, a change of velocity forgiven.
    """
    tested = comparison.tested
    r = np.where(tested[..., None], comparison.residual, 0.0)
    J = np.where(tested[..., None, None], comparison.J, 0.0)
    S = np.where(tested[..., None, None], comparison.S, np.eye(4))
    JJt = J @ np.swapaxes(J, -1, -2)
    span = comparison.span_s[:, None]
    S_static = S + JJt * ((settings.forgiven_speed_mps * span) ** 2)[..., None, None]
    distance = np.where(tested, _quadratic(S_static, r), 0.0).max(0)
    slack = (0.5 * ACCEL_SIGMA_MPS2 * comparison.span_s**2) ** 2
    velocity, covariance, cost = fit_velocities_compiled(
        comparison.residual, comparison.J_motion, comparison.S, comparison.J, slack,
        comparison.span_s, tested,
    )  # fmt: skip
    rows = tested.sum(0)
    explained = cost < VARIANCE_FACTOR * gates(np.maximum(4 * rows - 3, 1), 0.999)
    return StaticTest(distance, rows, velocity, covariance, explained)


def fixed_test(evidence: Evidence, settings: SegmentationSettings) -> Verdict:
    """The original's thresholds on the last interval: weighted 3-D distance and reprojection."""
    tested = evidence.comparison.tested[-1]
    with np.errstate(invalid="ignore"):
        far = evidence.distance_m > settings.distance_threshold_m
        off = evidence.reprojection_px > settings.reprojection_threshold_px
    moves = far | off if settings.combine == "any" else far & off
    return Verdict(tested, tested & moves, np.zeros_like(tested))


MOTION_TESTS: dict[str, MotionTest] = {"covariance": covariance_test, "fixed": fixed_test}


def _quadratic(S: FloatArray, r: FloatArray) -> FloatArray:
    """rᵀ S⁻¹ r over leading axes."""
    solved = np.linalg.solve(S, r[..., None])[..., 0]
    total: FloatArray = (r * solved).sum(-1)
    return total
