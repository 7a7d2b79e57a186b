"""Does a point move? The covariance-scaled test and the fixed thresholds.

Both take a `Comparison` and answer per feature; neither knows of tracks or images.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ovmot.config import SplitSettings
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.triangulation import inverse_3x3
from ovmot.objects.comparison import Comparison

_FORGIVEN_ACCEL = 3.0  # m/s²: what a road user's motion may depart from constant velocity


@dataclass(frozen=True, slots=True)
class Verdict:
    """Per feature (N,): tested at all, moves, or is neither at rest nor in any steady motion."""

    tested: BoolArray
    moving: BoolArray
    erratic: BoolArray


MotionTest = Callable[[Comparison, FloatArray, FloatArray, SplitSettings], Verdict]


def covariance_test(
    comparison: Comparison, distance_m: FloatArray, reprojection_px: FloatArray,
    settings: SplitSettings,
) -> Verdict:  # fmt: skip
    """Chi-squared test of rest over all earlier rows, then of one constant velocity.

    Under rest r ~ N(0, S + J Jᵀ (s Δt)²), where s forgives slow drifts of the ego motion. A point
    that fails in any row moves, if a single velocity v (least squares over the rows) explains all
    of them; if none does, its track is erratic: a wrong match rather than a motion.
    """
    tested = comparison.tested
    r = np.where(tested[..., None], comparison.residual, 0.0)
    J = np.where(tested[..., None, None], comparison.J, 0.0)
    JJt = J @ np.swapaxes(J, -1, -2)
    span = comparison.span_s[:, None]
    eye = np.eye(4)
    S = np.where(tested[..., None, None], comparison.S, eye)
    S_rest = S + JJt * ((settings.forgiven_speed_mps * span) ** 2)[..., None, None]
    d_rest = _quadratic(S_rest, r)
    bound = chi2.ppf(1.0 - settings.false_alarm, 4)
    fails = tested & (d_rest > bound)

    S_fit = S + JJt * ((0.5 * _FORGIVEN_ACCEL * span**2) ** 2)[..., None, None]
    W = np.linalg.inv(S_fit)
    Jv = J * span[..., None, None]
    JtW = np.swapaxes(Jv, -1, -2) @ W
    N = (JtW @ Jv).sum(0) + 1e-6 * np.eye(3)
    b = (JtW @ r[..., None]).sum(0)
    v = inverse_3x3(N) @ b
    left = r - (Jv @ v)[..., 0]
    cost = np.where(tested, np.einsum("lni,lnij,lnj->ln", left, W, left), 0.0).sum(0)
    rows = tested.sum(0)
    dof = np.maximum(4 * rows - 3, 1)
    explained = cost < 2.0 * chi2.ppf(0.999, dof)
    any_fails = fails.any(0)
    moving = any_fails & explained & (rows >= 2)
    return Verdict(rows > 0, moving, any_fails & ~moving)


def fixed_test(
    comparison: Comparison, distance_m: FloatArray, reprojection_px: FloatArray,
    settings: SplitSettings,
) -> Verdict:  # fmt: skip
    """The original's thresholds on the last interval: weighted 3-D distance and reprojection."""
    tested = comparison.tested[-1]
    with np.errstate(invalid="ignore"):
        far = distance_m > settings.distance_threshold_m
        off = reprojection_px > settings.reprojection_threshold_px
    moves = far | off if settings.combine == "any" else far & off
    return Verdict(tested, tested & moves, np.zeros_like(tested))


MOTION_TESTS: dict[str, MotionTest] = {"covariance": covariance_test, "fixed": fixed_test}


def _quadratic(S: FloatArray, r: FloatArray) -> FloatArray:
    """rᵀ S⁻¹ r over leading axes."""
    solved = np.linalg.solve(S, r[..., None])[..., 0]
    total: FloatArray = (r * solved).sum(-1)
    return total
