"""Is a body at rest? A test by the velocity's covariance, and one by fixed thresholds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.measurement_kernel import known_part_compiled
from ovmot.physics import gate
from ovmot.settings import ObjectSettings, SegmentationSettings


@dataclass(frozen=True, slots=True)
class FoundMotion:
    """A body's `velocity` (3,) in m/s with covariance (3, 3), and its N points `p_world` (N, 3).

    `T_now_before` (4, 4): its motion, p_now = T p_before, and `T_cam0_world` (4, 4) of the present
    left camera.
    """

    velocity: FloatArray
    covariance: FloatArray
    p_world: FloatArray
    T_now_before: FloatArray
    T_cam0_world: FloatArray

    @property
    def moved(self) -> FloatArray:
        """Where the points (N, 3) are, in the present left camera."""
        return se3.apply(self.T_cam0_world, self.p_world)

    @property
    def at_rest(self) -> FloatArray:
        """Where they would be (N, 3), had they stayed where they were."""
        return se3.apply(self.T_cam0_world @ se3.inverse(self.T_now_before), self.p_world)


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
    v, variance = known_part_compiled(motion.velocity, motion.covariance, MAX_SIGMA_MPS)
    if len(v) == 0:
        return True
    return float((v**2 / variance).sum()) < gate(len(v), 1.0 - of_points.false_alarm)


def is_static_by_thresholds(
    motion: FoundMotion,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> bool:
    """Mean displacement below α + β/N metres, or below γ/mean depth + δ/N pixels in the image.

    The depth component is weighted down; of both cameras the worse one counts.
    """
    moved, at_rest, n = motion.moved, motion.at_rest, len(motion.p_world)
    weights = np.array([1.0, 1.0, of_points.depth_weight])
    distance = np.linalg.norm((moved - at_rest) * weights, axis=1).mean()
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    h_moved, _ = project_stereo(moved, rig.T_cam1_cam0)
    h_rest, _ = project_stereo(at_rest, rig.T_cam1_cam0)
    off = (h_moved - h_rest) * focal
    pixels = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3])).mean()
    depth = float(moved[:, 2].mean())
    near = distance < settings.alpha_m + settings.beta_m / n
    near_in_image = pixels < settings.gamma_px_m / depth + settings.delta_px / n
    return bool(near or near_in_image)


STATIC_TESTS: dict[str, StaticTest] = {
    "covariance": is_static_by_covariance,
    "fixed": is_static_by_thresholds,
}
