"""Classes of motion: walker, cyclist or vehicle, as a probability from size and speed history.

By Bayes' rule, with the shares of trips as priors and no learned model. A box that was seen says
that the body is at least so large: a seen extent is taken as uniform from nothing to the body's.
Speeds come from the distributions of `physics.py`; all those of one body are one observation,
since it keeps its pace. Who is slower than `SLOW_MPS` may be anyone who stops, and the speed says
nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.motion_class_kernel import (
    Classes,
    size_log_likelihood_compiled,
    speed_log_likelihood_compiled,
)
from ovmot.physics import (
    CAR_SIZE_M,
    CYCLIST_MPS,
    CYCLIST_SIGMA_MPS,
    CYCLIST_SIZE_M,
    MAX_ROAD_MPS,
    ODD_SPEED_SHARE,
    SIZE_SPREAD,
    SLOW_MPS,
    TRIP_SHARES,
    WALKER_MPS,
    WALKER_SIGMA_MPS,
    WALKER_SIZE_M,
)

CLASSES = ("walker", "cyclist", "vehicle")
"""In the order of all arrays (3,) of classes."""
_CLASSES = Classes(
    size=np.array([WALKER_SIZE_M, CYCLIST_SIZE_M, CAR_SIZE_M]),
    size_spread=SIZE_SPREAD,
    greatest_mps=np.array(MAX_ROAD_MPS),
    pace=np.array([WALKER_MPS, CYCLIST_MPS]),
    pace_spread=np.array([WALKER_SIGMA_MPS, CYCLIST_SIGMA_MPS]),
    odd_share=ODD_SPEED_SHARE,
)


@dataclass(frozen=True, slots=True)
class SpeedHistory:
    """What a body's speeds so far say of its class: the sum of their log-likelihoods (3,) over the
    `frames` in which it moved."""

    log_likelihood: FloatArray
    frames: int


def no_history() -> SpeedHistory:
    """Of a body that is new."""
    return SpeedHistory(np.zeros(len(CLASSES)), 0)


def with_speed(history: SpeedHistory, speed: float, log_likelihood: FloatArray) -> SpeedHistory:
    """The history with one more speed, m/s, and its log-likelihood (3,); slow ones add nothing."""
    if not speed >= SLOW_MPS:
        return history
    return SpeedHistory(history.log_likelihood + log_likelihood, history.frames + 1)


def history_log_likelihood(history: SpeedHistory) -> FloatArray:
    """Log-likelihood (3,) of all speeds so far: their mean, since one body keeps its pace."""
    return np.asarray(history.log_likelihood / max(history.frames, 1))


def class_probability(speeds: FloatArray, sizes: FloatArray) -> FloatArray:
    """Probability (..., 3) of each of `CLASSES` from the log-likelihoods (..., 3) of both."""
    total = np.log(TRIP_SHARES) + speeds + sizes
    probability = np.exp(total - total.max(axis=-1, keepdims=True))
    return np.asarray(probability / probability.sum(axis=-1, keepdims=True))


def speed_log_likelihood(speed: FloatArray, sigma: FloatArray) -> FloatArray:
    """Log density (T, 3) of speeds (T,), m/s, measured with these standard deviations (T,).

    Walkers and cyclists go at their usual pace; some, as runners, and all vehicles at any speed up
    to the greatest of their class.
    """
    return speed_log_likelihood_compiled(speed, sigma, _CLASSES)


def size_log_likelihood(size: FloatArray, sigma: FloatArray, faces: BoolArray) -> FloatArray:
    """Log density (T, 3) of what was seen of bodies: length, width and height (T, 3) m.

    `sigma` (T, 3): their standard deviations; `faces` (T, 3): whether both ends were in view, else
    the body may be of any size from what was seen on. NaN counts as not seen. Of a body's extent s,
    what is seen of it has the density 1/s up to s, which has the class's spread; s itself stands
    for its mean in the density. Vehicles are of all lengths, widths and heights from a car's on.
    """
    return size_log_likelihood_compiled(size, sigma, faces, _CLASSES)


def classified(
    histories: Sequence[SpeedHistory], speed: FloatArray, speed_sigma: FloatArray,
    size: FloatArray, size_sigma: FloatArray, faces: BoolArray,
) -> tuple[list[SpeedHistory], FloatArray]:  # fmt: skip
    """The histories of T tracks with their speeds (T,), m/s, of this time, and the probabilities
    (T, 3) of each track's classes, also by what was seen of its size (T, 3), m, and of its `faces`
    (T, 3)."""
    now = speed_log_likelihood(speed, speed_sigma)
    each = zip(histories, speed.tolist(), now, strict=True)
    kept = [with_speed(history, v, likelihood) for history, v, likelihood in each]
    of_speeds = np.array([history_log_likelihood(history) for history in kept])
    return kept, class_probability(of_speeds, size_log_likelihood(size, size_sigma, faces))
