"""Compiled log-likelihoods of classes of motion by speed and by size.

tests/objects/test_motion_class_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, part

_HEIGHT = 2  # among the sides of a box


class Classes(NamedTuple):
    """Of C classes: sizes (C, 3) with their spread as a share, and greatest speeds (C,), m/s. All
    but the last have a usual `pace` (C - 1,) with its spread; a share of them goes at any speed."""

    size: FloatArray
    size_spread: float
    greatest_mps: FloatArray
    pace: FloatArray
    pace_spread: FloatArray
    odd_share: float


@part
def log_normal_cdf(x: float) -> float:
    """Logarithm of the standard normal distribution at x; where that is less than a float can hold,
    the first terms of its asymptotic series (M. Abramowitz & I. Stegun, 26.2.12)."""
    if x >= 0.0:
        return math.log1p(-0.5 * math.erfc(x / math.sqrt(2.0)))
    tail = 0.5 * math.erfc(-x / math.sqrt(2.0))
    if tail > 0.0:
        return math.log(tail)
    return log_normal(x) - math.log(-x) + math.log1p(-1.0 / (x * x))


@part
def log_normal(x: float) -> float:
    """Logarithm of the standard normal density at x."""
    return -0.5 * (x * x + math.log(2.0 * math.pi))


def speed_log_likelihood(speed: FloatArray, sigma: FloatArray, classes: Classes) -> FloatArray:
    """Log density (T, C) of speeds (T,), m/s, measured with standard deviations (T,), not 0."""
    out = np.empty((len(speed), len(classes.size)))
    for t in range(len(speed)):
        for c in range(out.shape[1]):
            most = classes.greatest_mps[c]
            out[t, c] = log_normal_cdf((most - speed[t]) / sigma[t])
            out[t, c] -= math.log(most)
            if c < len(classes.pace):
                spread = math.hypot(classes.pace_spread[c], sigma[t])
                z = (speed[t] - classes.pace[c]) / spread
                usual = log_normal(z) - math.log(spread)
                usual += math.log1p(-classes.odd_share)
                odd = math.log(classes.odd_share) + out[t, c]
                larger = max(usual, odd)
                out[t, c] = larger + math.log1p(math.exp(min(usual, odd) - larger))
    return out


def size_log_likelihood(
    size: FloatArray, sigma: FloatArray, faces: BoolArray, classes: Classes
) -> FloatArray:
    """Log density (T, C) of what was seen of bodies: length, width, height (T, 3) m, with standard
    deviations (T, 3). Where its `faces` (T, 3) were not in view, a side is at least so long. NaN
    counts as not seen; the longer level side is held against the length.

    Those of the last class are of all sizes from the given one on.
    """
    n_classes = len(classes.size)
    out = np.zeros((len(size), n_classes))
    for t in range(len(size)):
        turned = size[t, 1] > size[t, 0] or not math.isfinite(size[t, 0])
        for a in range(3):
            side = 1 - a if turned and a != _HEIGHT else a
            seen = size[t, side]
            for c in range(n_classes):
                typical = classes.size[c, a]
                if math.isfinite(seen) and faces[t, side]:
                    out[t, c] -= math.log(typical)
                if math.isfinite(seen) and c < n_classes - 1:
                    spread = math.hypot(classes.size_spread * typical, sigma[t, side])
                    out[t, c] += log_normal_cdf((typical - seen) / spread)
    return out


_FOLDER = code_folder(Path(__file__))
speed_log_likelihood_compiled = compiled(speed_log_likelihood, _FOLDER)
size_log_likelihood_compiled = compiled(size_log_likelihood, _FOLDER)
