"""Does a body move? The likelihood ratio of its way since it was first seen, for a sequential test.

A. Wald, "Sequential Tests of Statistical Hypotheses", Ann. Math. Stat. 16, 1945. The filter of a
body begins at a place that defines its frame, without covariance: the covariance of its place now
is that of the way since then, from all views of all features, patches that drifted and the ego's
steps included.
"""

import math
from typing import NamedTuple

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body import VELOCITY
from ovmot.objects.body_step_kernel import Body, FrameViews
from ovmot.physics import (
    CYCLIST_MPS,
    CYCLIST_SIGMA_MPS,
    DEPTH_SLIDE_SHARE,
    LEAST_MATCH_SIGMA_PX,
    LENS_SCALE_SIGMA,
    LENS_SIGMA_PX,
    ROAD_SPEED_SIGMA_MPS,
    SLIDE_SHARE,
    WALKER_MPS,
    WALKER_SIGMA_MPS,
)

_ANY_WAY_M = 1e3  # standard deviation of a way of which nothing is known


class Origin(NamedTuple):
    """Where a body's filter began: its `place` (3,) then and the left camera's pose `T_world_cam0`
    (4, 4) then, both in the world as it is now."""

    timestamp_ns: int
    place: FloatArray
    T_world_cam0: FloatArray


def _velocity_variances() -> FloatArray:
    """Of a walker's, a cyclist's and a vehicle's velocity (3, 3): each class in any level
    direction, and as much upwards as road users' slopes have it."""
    level = ROAD_SPEED_SIGMA_MPS[0]
    pace = [math.hypot(WALKER_MPS, WALKER_SIGMA_MPS), math.hypot(CYCLIST_MPS, CYCLIST_SIGMA_MPS)]
    sigma = np.array([*(p / math.sqrt(2.0) for p in pace), level])
    return np.asarray(np.square(np.outer(sigma, ROAD_SPEED_SIGMA_MPS) / level))


_VARIANCES = _velocity_variances()


def carried_origin(origin: Origin, correction: FloatArray) -> Origin:
    """The origin after a correction (4, 4) of the world that the rig's poses are in."""
    return origin._replace(
        place=se3.apply(correction, origin.place), T_world_cam0=correction @ origin.T_world_cam0
    )


def body_log_ratio(
    body: Body, origin: Origin, frame: FrameViews, n_features: int, found_again: int
) -> float:
    """Logarithm of the likelihood of what was seen of a body if it moves, over that if it rests.

    At rest the way since its origin is an error of the lens models and of the views; or it is that
    of patches which slid together, and its velocity now is such an error. It was seen by
    `n_features`, and `found_again` in so many frames after its birth.
    """
    seconds = 1e-9 * (body.timestamp_ns - origin.timestamp_ns)
    if not seconds > 0.0:
        return 0.0
    x, P = body.state.x, body.state.P
    lens = lens_doubt(x[:3], origin, frame)
    way, covariance = x[:3] - origin.place, P[:3, :3] + lens
    ray = x[:3] - frame.step.centre
    unknown = np.outer(ray, ray) * (_ANY_WAY_M / np.linalg.norm(ray)) ** 2
    of_change = P[VELOCITY, VELOCITY] + lens / seconds**2
    ratios = log_ratios(
        np.stack([way, way, x[VELOCITY]]),
        np.stack([covariance, covariance + unknown, of_change]),
        np.array([seconds, seconds, 1.0]),
    )
    of_way, across, of_velocity = ratios.tolist()
    return against_slides(of_way, across, of_velocity, n_features, found_again)


def against_slides(
    of_way: float, of_across: float, of_velocity: float, n_features: int, found_again: int
) -> float:
    """The log-ratio against rest or patches that slid together, by those of the way, of its part
    across the ray, and of the velocity.

    Each feature that has the motion of the first two slides with `SLIDE_SHARE`, and with
    `DEPTH_SLIDE_SHARE` where only its disparity does: such a slide is a way along the ray. A drift
    is a random walk, which goes on in the same quadrant with 1/4: what the velocity says counts up
    to that for each frame in which the motion was found again, since the body was found by its
    velocity.
    """
    n_more, drifts = max(n_features - 2, 0), min(of_velocity, found_again * math.log(4.0))
    slides = n_more * math.log(SLIDE_SHARE) - drifts
    in_depth = n_more * math.log(DEPTH_SLIDE_SHARE) - max(of_across, 0.0) - drifts
    return -float(np.logaddexp.reduce([-of_way, slides, in_depth]))


def log_ratios(way: FloatArray, covariance: FloatArray, seconds: FloatArray) -> FloatArray:
    """The same (B,) of ways (B, 3) that took so many seconds (B,), with covariances (B, 3, 3).

    A body at rest has the way zero; road users' velocities are a mixture of their classes', each
    Gaussian about zero. The ratio of one datum after the other is a martingale if the body rests:
    it ever exceeds 1/α with a probability of at most α (J. Ville, 1939).
    """
    C = np.repeat(covariance[:, None], 1 + len(_VARIANCES), axis=1)
    C[:, 1:, range(3), range(3)] += np.square(seconds)[:, None, None] * _VARIANCES
    _, log_det = np.linalg.slogdet(C)
    off = np.broadcast_to(way[:, None, :, None], (*C.shape[:3], 1))
    squared = (np.linalg.solve(C, off)[..., 0] * way[:, None]).sum(-1)
    log_density = -0.5 * (squared + log_det)
    moving = np.logaddexp.reduce(log_density[:, 1:], axis=1) - math.log(len(_VARIANCES))
    return np.asarray(moving - log_density[:, 0])


def lens_doubt(place: FloatArray, origin: Origin, frame: FrameViews) -> FloatArray:
    """Covariance (3, 3) that lens models, and the matching of one texture, give to a way, m².

    Their errors are common to features that are near each other: many of them know a way no better
    than one. What stands where it is seen now seems to have moved by the errors of the disparity at
    both ends, each along its ray. They are one error where it is seen at one place in the image,
    and differ by a share of the way that it takes through the image, until they have nothing in
    common; those of matches differ with the disparity. Across the ray it seems to move by that
    share of the way that the rig's turning takes it through the image.
    """
    now = se3.apply(frame.T_cam0_world, place)
    then = se3.apply(se3.inverse(origin.T_world_cam0), place)
    way_px = frame.focal * _angle(now, then)
    differ = min(0.5 * (LENS_SCALE_SIGMA * way_px / LENS_SIGMA_PX) ** 2, 1.0)
    depth = [frame.T_world_cam0[:3, :3] @ now, origin.T_world_cam0[:3, :3] @ then]
    per_px = np.array([r * np.linalg.norm(r) for r in depth]) / (frame.focal * frame.baseline)
    errors = 2.0 * LENS_SIGMA_PX**2 * np.array([[1.0, differ - 1.0], [differ - 1.0, 1.0]])
    errors = errors + LEAST_MATCH_SIGMA_PX**2 * np.eye(2)
    across = (LENS_SCALE_SIGMA * _turned(origin, frame) * float(np.linalg.norm(now))) ** 2
    return per_px.T @ errors @ per_px + across * np.eye(3)


def _angle(a: FloatArray, b: FloatArray) -> float:
    """Between two vectors (3,), rad."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _turned(origin: Origin, frame: FrameViews) -> float:
    """Angle between the rig's orientations then and now, rad."""
    trace = float((origin.T_world_cam0[:3, :3] * frame.T_world_cam0[:3, :3]).sum())
    return math.acos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
