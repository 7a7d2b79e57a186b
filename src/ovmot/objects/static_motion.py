"""Which bodies are at rest? A test by the velocity's covariance, and one by fixed thresholds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.bodies_kernel import distance_from_rest_compiled
from ovmot.objects.measurement_kernel import MeasuredBodies
from ovmot.physics import WALKER_MPS, gates
from ovmot.settings import ObjectSettings, SegmentationSettings


@dataclass(frozen=True, slots=True)
class FoundMotions:
    """B bodies as `measured`, M points `p_world` (M, 3) of them, and the left camera's pose now."""

    measured: MeasuredBodies
    p_world: FloatArray
    T_world_cam0: FloatArray


StaticTest = Callable[[FoundMotions, StereoRig, ObjectSettings, SegmentationSettings], BoolArray]

MAX_SIGMA_MPS = WALKER_MPS
"""A direction in which a velocity is known no better than this does not count."""


def static_by_covariance(
    motions: FoundMotions,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> BoolArray:
    """Chi-squared test (B,) of no velocity, in the directions in which it is known.

    The covariance holds the points' and the poses' part.
    """
    measured = motions.measured
    distance, dof = distance_from_rest_compiled(
        measured.velocity, measured.covariance, MAX_SIGMA_MPS
    )
    bounds = gates(3, 1.0 - of_points.false_alarm)
    return np.asarray((distance < bounds[dof]) | (dof == 0))


def static_by_thresholds(
    motions: FoundMotions,
    rig: StereoRig,
    settings: ObjectSettings,
    of_points: SegmentationSettings,
) -> BoolArray:
    """Mean displacement below α + β/N metres, or below γ/mean depth + δ/N pixels in the image.

    The depth component is weighted down; of both cameras the worse one counts.
    """
    measured, T_cam0_world = motions.measured, se3.inverse(motions.T_world_cam0)
    n_bodies = len(measured.n_members)
    body = np.repeat(np.arange(n_bodies), measured.n_members)
    n = np.maximum(measured.n_members, 1)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(body, values, n_bodies) / n)

    p_world = motions.p_world[measured.members[: len(body)]]
    moved = se3.apply(T_cam0_world, p_world)
    back = T_cam0_world @ se3.inverse(measured.T_now_before)
    at_rest = se3.apply(back[body], p_world)
    weights = np.array([1.0, 1.0, of_points.depth_weight])
    distance = mean(np.linalg.norm((moved - at_rest) * weights, axis=1))
    focal = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
    h_moved, _ = project_stereo(moved, rig.T_cam1_cam0)
    h_rest, _ = project_stereo(at_rest, rig.T_cam1_cam0)
    off = (h_moved - h_rest) * focal
    pixels = mean(np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3])))
    near = distance < settings.alpha_m + settings.beta_m / n
    depth = mean(moved[:, 2])
    with np.errstate(divide="ignore"):  # a body without points
        near_in_image = pixels < settings.gamma_px_m / depth + settings.delta_px / n
    return np.asarray(near | near_in_image)


STATIC_TESTS: dict[str, StaticTest] = {
    "covariance": static_by_covariance,
    "fixed": static_by_thresholds,
}
