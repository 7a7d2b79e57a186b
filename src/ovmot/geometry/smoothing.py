"""Smoothing of samples at uneven times into a uniform B-spline: a low-pass filter with a cut-off.

P. Eilers, B. Marx, "Flexible Smoothing with B-splines and Penalties", Statistical Science 1996.
"""

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from ovmot.geometry.arrays import FloatArray

_DEGREE = 5
_PENALTY_ORDER = 3


def low_pass(seconds: FloatArray, values: FloatArray, cutoff_hz: float, step_s: float) -> BSpline:
    """The quintic spline s(t) with knots every `step_s` that smooths values (N, K) at times (N,).

    It minimises Σ |values - s|² + λ ∫ |s'''|² dt, the integral by third differences of the
    control points. With λ = rate / (2π cutoff)⁶ a long signal passes as through a zero-phase filter
    1 / (1 + (f / cutoff)⁶), at half height at `cutoff_hz`, and somewhat below it where that comes
    near 1 / (2 `step_s`). In holes of the data the penalty alone decides: the spline bridges them
    with as little jerk as it can. It covers the first to the last time, and up to a step more.
    """
    steps = max(int(np.ceil((seconds[-1] - seconds[0]) / step_s - 1e-9)), 1)
    knots = seconds[0] + step_s * np.arange(-_DEGREE, steps + _DEGREE + 1)
    basis = BSpline.design_matrix(np.clip(seconds, seconds[0], knots[-_DEGREE - 1]), knots, _DEGREE)
    rate = 1.0 / np.median(np.diff(seconds))
    weight = rate * (2.0 * np.pi * cutoff_hz) ** (-2 * _PENALTY_ORDER)
    rough = _differences(basis.shape[1], _PENALTY_ORDER)
    penalty = weight * step_s ** (1 - 2 * _PENALTY_ORDER) * (rough.T @ rough)
    mean = values.mean(axis=0)
    control = splu((basis.T @ basis + penalty).tocsc()).solve(basis.T @ (values - mean))
    return BSpline(knots, control + mean, _DEGREE)


def _differences(count: int, order: int) -> csr_matrix:
    """The matrix (count - order, count) of differences of this order."""
    matrix = identity(count, format="csr")
    for _ in range(order):
        matrix = matrix[1:] - matrix[:-1]
    return csr_matrix(matrix)
