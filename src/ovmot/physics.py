"""What more than one stage must agree on: pixel noise, road users' motions and sizes, gates.

A number here is a fact with its source, or a stated standard deviation. Stages derive from it what
they need; none has a value of its own.
"""

from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from ovmot.geometry.arrays import FloatArray

# Features in the image.
PIXEL_SIGMA = 0.4
"""Standard deviation of each pixel coordinate of a stereo match, pixels, before it is measured.

Of sub-pixel registration of patches by Lucas-Kanade on real images (S. Baker & I. Matthews, IJCV
2004, find some tenths of a pixel)."""

# Road users. Sources: Directive 96/53/EC (greatest vehicle dimensions), friction of dry asphalt.
MAX_ACCEL_MPS2 = 8.0
"""Hardest braking of a road user: 0.8 g, the friction of tyres on dry asphalt."""
ACCEL_SIGMA_MPS2 = 1.5
"""Standard deviation of a road user's acceleration along and across its way in ordinary traffic."""
MAX_YAW_RATE_RPS = 2.0
"""Beyond what a body on a road turns by: 0.8 g at 4 m/s."""
CAR_SIZE_M = (4.5, 1.9, 1.5)
"""Length, width and height of a passenger car."""
MAX_VEHICLE_SIZE_M = (18.75, 2.6, 4.0)
"""Greatest length, width and height of a vehicle on a road (Directive 96/53/EC)."""

WALKER_MPS = 1.34
"""Mean speed of a walker (U. Weidmann, Transporttechnik der Fussgänger, 1993)."""
SPEED_SPREAD_MPS = 0.5
"""By which velocities of points of one body differ, standard deviation: the two ends of a car that
turns by 0.2 rad/s."""

# A rig at rest on its springs or its tripod.
REST_SHIFT_M = 0.01
"""A body that rocks on its springs moves its camera by up to this."""


@lru_cache(maxsize=4096)
def gate(dof: int, probability: float) -> float:
    """Squared Mahalanobis distance that a true measurement of `dof` degrees of freedom stays below
    with this probability: a quantile of the chi-squared distribution."""
    return float(chdtri(dof, 1.0 - probability))


def gates(dof: FloatArray, probability: float) -> FloatArray:
    """The same for arrays (N,) of degrees of freedom."""
    return np.asarray(chdtri(dof, 1.0 - probability))
