"""Is a body at rest? A test by the velocity's covariance, and one by fixed thresholds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.physics import gate
from ovmot.settings import ObjectSettings, SegmentationSettings


@dataclass(frozen=True, slots=True)
class FoundMotion:
    """A body's `velocity` (3,) in m/s with covariance (3, 3), in world, and its N points in the
    present left camera: `moved` (N, 3), where they are, and `at_rest` (N, 3), where the ego motion
    alone takes the refined earlier points."""

    velocity: FloatArray
    covariance: FloatArray
    moved: FloatArray
    at_rest: FloatArray


StaticTest = Callable[[FoundMotion, StereoRig, ObjectSettings, SegmentationSettings], bool]

MAX_SIGMA_MPS = 1.5
"""A direction in which a velocity is known no better than this, a walking pace, does not count."""


def is_static_by_covariance(
    motion: FoundMotion,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> bool:
    """Chi-squared test of no velocity, in the directions in which it is known.

    The covariance holds the points' and the poses' part.
    """
    v, variance = known_part(motion.velocity, motion.covariance, MAX_SIGMA_MPS)
    if len(v) == 0:
        return True
    return float((v**2 / variance).sum()) < gate(len(v), 1.0 - of_points.false_alarm)


def known_part(
    velocity: FloatArray, covariance: FloatArray, max_sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Components (k,) of a velocity (3,) along those principal axes of its covariance (3, 3) in
    which it is known to `max_sigma`, and their variances (k,).

    The unknown part of a far body is along the ray, where the errors of patches are not white: they
    drift together.
    """
    variance, axes = np.linalg.eigh(covariance)
    known = variance < max_sigma**2
    return axes.T[known] @ velocity, variance[known]


def is_static_by_thresholds(
    motion: FoundMotion,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> bool:
    """Mean displacement below α + β/N metres, or below γ/mean depth + δ/N pixels in the image.

    The depth component is weighted down; of both cameras the worse one counts.
    """
    n = len(motion.moved)
    weights = np.array([1.0, 1.0, of_points.depth_weight])
    distance = np.linalg.norm((motion.moved - motion.at_rest) * weights, axis=1).mean()
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    h_moved, _ = project_stereo(motion.moved, rig.T_cam1_cam0)
    h_rest, _ = project_stereo(motion.at_rest, rig.T_cam1_cam0)
    off = (h_moved - h_rest) * focal
    pixels = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3])).mean()
    depth = float(motion.moved[:, 2].mean())
    near = distance < settings.alpha_m + settings.beta_m / n
    near_in_image = pixels < settings.gamma_px_m / depth + settings.delta_px / n
    return bool(near or near_in_image)


STATIC_TESTS: dict[str, StaticTest] = {
    "covariance": is_static_by_covariance,
    "fixed": is_static_by_thresholds,
}
