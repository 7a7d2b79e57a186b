"""Classes of motion: walker, cyclist or vehicle, as a probability from size and speed history.

By Bayes' rule, with equal priors and no learned model. A box that was seen says that the body is at
least so large: a seen extent is taken as uniform from nothing to the body's. Speeds come from the
distributions of `physics.py`; those within a manoeuvre are one observation. Who is slower than
`SLOW_MPS` may be anyone who stops, and the speed says nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ovmot.geometry.arrays import FloatArray
from ovmot.physics import (
    CAR_SIZE_M,
    CYCLIST_MPS,
    CYCLIST_SIGMA_MPS,
    CYCLIST_SIZE_M,
    MANOEUVRE_S,
    MAX_ROAD_MPS,
    ODD_SPEED_SHARE,
    SIZE_SPREAD,
    WALKER_MPS,
    WALKER_SIGMA_MPS,
    WALKER_SIZE_M,
)
from ovmot.types import ObjectTrack

CLASSES = ("walker", "cyclist", "vehicle")
"""In the order of all arrays (3,) of classes."""
SLOW_MPS = 0.5
"""Half of the slowest walking (R. Bohannon, Age and Ageing 26, 1997: comfortable gait from 1.0)."""
_SIZES = np.array([WALKER_SIZE_M, CYCLIST_SIZE_M, CAR_SIZE_M])
_MAX_MPS = np.array(MAX_ROAD_MPS)


@dataclass(frozen=True, slots=True)
class SpeedHistory:
    """What a body's speeds so far say of its class.

    `log_likelihood` (3,) is the sum over `frames` in which it moved, from `first_ns` to `last_ns`.
    """

    log_likelihood: FloatArray
    frames: int
    first_ns: int
    last_ns: int


def no_history(timestamp_ns: int) -> SpeedHistory:
    """Of a body that is new."""
    return SpeedHistory(np.zeros(len(CLASSES)), 0, timestamp_ns, timestamp_ns)


def with_speed(
    history: SpeedHistory, timestamp_ns: int, speed: float, sigma: float
) -> SpeedHistory:
    """The history with one more speed, m/s, and its standard deviation; a slow one adds nothing."""
    if not speed >= SLOW_MPS:
        return history
    return SpeedHistory(
        history.log_likelihood + speed_log_likelihood(speed, sigma),
        history.frames + 1,
        timestamp_ns if history.frames == 0 else history.first_ns,
        timestamp_ns,
    )


def class_probability(
    history: SpeedHistory, size: FloatArray, size_sigma: FloatArray
) -> FloatArray:
    """Probability (3,) of each of `CLASSES`.

    `size` (3,): length, width, height of what was seen, m; `size_sigma` (3,): its standard
    deviations. NaN counts as not seen.
    """
    total = size_log_likelihood(size, size_sigma)
    if history.frames:
        span_s = 1e-9 * (history.last_ns - history.first_ns)
        observations = 1.0 + span_s / MANOEUVRE_S
        total = total + observations / history.frames * history.log_likelihood
    probability: FloatArray = np.exp(total - logsumexp(total))
    return probability


def speed_log_likelihood(speed: float, sigma: float) -> FloatArray:
    """Log density (3,) of a speed, m/s, measured with this standard deviation.

    Walkers and cyclists go at their usual pace; some, as runners, and all vehicles at any speed up
    to the greatest of their class.
    """
    pace = np.array([WALKER_MPS, CYCLIST_MPS])
    spread = np.hypot(np.array([WALKER_SIGMA_MPS, CYCLIST_SIGMA_MPS]), sigma)
    usual = -0.5 * ((speed - pace) / spread) ** 2 - np.log(spread * np.sqrt(2.0 * np.pi))
    reach = np.maximum(sigma, 1e-3)
    anywhere = log_ndtr((_MAX_MPS - speed) / reach) - np.log(_MAX_MPS)
    odd = np.log(ODD_SPEED_SHARE)
    named = np.logaddexp(np.log1p(-ODD_SPEED_SHARE) + usual, odd + anywhere[:2])
    return np.append(named, anywhere[2])


def size_log_likelihood(size: FloatArray, sigma: FloatArray) -> FloatArray:
    """Log density (3,) of the seen extents: the longer level one, the shorter one, the height.

    A density of 1/s up to the body's extent s, which has the class's spread; s itself stands for
    its mean in the density.
    """
    level = np.argsort(-np.asarray(size[:2]))
    seen = np.append(np.asarray(size)[level], size[2])
    noise = np.append(np.asarray(sigma)[level], sigma[2])
    spread = np.hypot(SIZE_SPREAD * _SIZES, noise)
    each = log_ndtr((_SIZES - seen) / spread) - np.log(_SIZES)
    # vehicles are of all lengths, widths and heights from a car's on
    each[2] = -np.log(_SIZES[2])
    return np.asarray(np.where(np.isfinite(seen), each, 0.0).sum(axis=1))


def classified(
    histories: Mapping[int, SpeedHistory], tracks: Sequence[ObjectTrack], timestamp_ns: int
) -> tuple[dict[int, SpeedHistory], tuple[ObjectTrack, ...]]:
    """The tracks of a frame with `class_probability` set, and the histories of these tracks.

    The uncertainty of an extent is that of the centre, to which the box's ends are bound.
    """
    kept: dict[int, SpeedHistory] = {}
    named = []
    for track in tracks:
        history = histories.get(track.track_id) or no_history(timestamp_ns)
        speed = float(np.linalg.norm(track.velocity[:2]))
        sigma = float(np.linalg.norm(track.std_velocity[:2]) / np.sqrt(2.0))
        history = with_speed(history, timestamp_ns, speed, sigma)
        kept[track.track_id] = history
        probability = class_probability(history, track.size, track.std_position)
        named.append(replace(track, class_probability=probability))
    return kept, tuple(named)
