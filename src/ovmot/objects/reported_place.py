"""Where a track is reported: its centre without the steps that each new view corrects it by.

The filter's place is the best estimate of each frame. A new view moves it by a part of its error,
and the world that it is in by a part of the rig's: to and fro, as no body moves. So that the trail
of a track is as smooth as the body's way, the reported centre follows these steps within
`object_tracks.smoothing_s`. How far it is behind is known: no more than the estimate may be off by
(95 %), and in its stated sigma.
"""

import math

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_box_kernel import Box
from ovmot.physics import SIGMAS_95

AT_ITS_PLACE = np.zeros(3)
"""The lag of a centre that is reported where it was estimated."""


def lag_after(lag: FloatArray, old: Box, new: Box, dt: float, smoothing_s: float) -> FloatArray:
    """How far (3,) the reported centre is from the estimated one, dt seconds after it was `lag`.

    What the centre went besides its velocity, in the mean of both times, was a step. The lag
    decays with the time constant `smoothing_s`.
    """
    step = new.centre - old.centre - 0.5 * dt * (old.velocity + new.velocity)
    kept = math.exp(-dt / smoothing_s) if smoothing_s > 0.0 else 0.0
    bound = SIGMAS_95 * centre_sigma(new)
    return np.clip(kept * (lag - step), -bound, bound)


def centre_sigma(box: Box) -> FloatArray:
    """Standard deviation (3,) of a box's estimated centre, in world.

    The face that was seen stays: the centre is off by half of what the size is.
    """
    half, along = np.square(0.5 * box.std_size), math.cos(box.yaw) ** 2
    of_size = (
        along * half[0] + (1.0 - along) * half[1],
        (1.0 - along) * half[0] + along * half[1],
        half[2],
    )
    variance = np.maximum(box.covariance.diagonal()[:3], 0.0) + of_size
    return np.asarray(np.sqrt(variance))
