"""Does a point move? The covariance-scaled test and the fixed thresholds.

Both take the `Evidence` of a frame and answer per feature; neither knows of tracks or images.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.segmentation.history_kernel import fit_velocities_compiled
from ovmot.segmentation.neighbour_consensus import neighbours_with_same_velocity
from ovmot.segmentation.stereo_history import Comparison
from ovmot.settings import SegmentationSettings

_FORGIVEN_ACCEL = 3.0  # m/s²: what a road user's motion may depart from constant velocity
_FIT_SLACK = 2.0  # on the bound of the constant-velocity fit, for patches that slide
_WEAK_PROBABILITY = 0.99  # of rest, for a point whose neighbours are seen to move
_MIN_NEIGHBOURS = 1  # that a moving point must have
_MIN_FRESH_NEIGHBOURS = 2  # of a point that was seen but once before
_MIN_STRONG_NEIGHBOURS = 2  # that make a weak case a moving point


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of N points: the comparisons, positions now (N, 3) in the left camera with
    covariance (N, 3, 3), and over the last interval the weighted distance (N,) in metres and the
    reprojection error (N,) in pixels."""

    comparison: Comparison
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
class RestTest:
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
    rest = examine_rest(evidence.comparison, settings)
    tested = rest.rows > 0
    impossible = tested & (rest.distance > chdtri(4, settings.false_alarm))
    unlikely = tested & (rest.distance > chdtri(4, 1.0 - _WEAK_PROBABILITY))
    steady = rest.explained & (rest.rows >= 2)
    strong, weak = impossible & steady, unlikely & steady
    certain = rest.distance > chdtri(4, settings.false_alarm**2)
    fresh = certain & rest.explained & (rest.rows == 1)
    alike = neighbours_with_same_velocity(
        evidence.p_cam0, evidence.cov_cam0, rest.velocity, rest.covariance, weak | fresh
    )
    supported = alike.sum(1) >= _MIN_NEIGHBOURS
    carried = (alike & strong[None, :]).sum(1) >= _MIN_STRONG_NEIGHBOURS
    company = (alike & (strong | fresh)[None, :]).sum(1) >= _MIN_FRESH_NEIGHBOURS
    moving = (strong & supported) | (weak & carried) | (fresh & company)
    return Verdict(tested, moving, impossible & ~moving)


def examine_rest(comparison: Comparison, settings: SegmentationSettings) -> RestTest:
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
    S_rest = S + JJt * ((settings.forgiven_speed_mps * span) ** 2)[..., None, None]
    distance = np.where(tested, _quadratic(S_rest, r), 0.0).max(0)
    slack = (0.5 * _FORGIVEN_ACCEL * comparison.span_s**2) ** 2
    velocity, covariance, cost = fit_velocities_compiled(
        comparison.residual, comparison.J_motion, comparison.S, comparison.J, slack,
        comparison.span_s, tested,
    )  # fmt: skip
    rows = tested.sum(0)
    explained = cost < _FIT_SLACK * chdtri(np.maximum(4 * rows - 3, 1), 0.001)
    return RestTest(distance, rows, velocity, covariance, explained)


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
