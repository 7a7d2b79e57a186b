"""Bundle adjustment of bodies: their twists and all their points, by reprojection errors.

A body has one twist (ω, v) over the span: ω and v are along the world's axes, v is the velocity of
the body's point at `origin` now. A present point X was at M(s) X s seconds ago, with M(s) =
exp(-s (ω, v)) about the origin. Points are eliminated from the normal equations (Schur complement;
B. Triggs et al., "Bundle adjustment", 2000, sec. 6.1), all bodies of a frame in one batch.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import BoolArray
from ovmot.objects.body_views_kernel import BodyViews
from ovmot.objects.refined_bodies_kernel import (
    RefinedBodies,
    StereoPixels,
    refine_bodies_compiled,
)
from ovmot.physics import gates
from ovmot.settings import ObjectSettings
from ovmot.types import PixelNoise


def refine_bodies(
    views: BodyViews,
    may_turn: BoolArray,
    rig: StereoRig,
    settings: ObjectSettings,
    noise: PixelNoise,
) -> RefinedBodies:
    """Levenberg-damped Gauss-Newton from the twists and stereo points of the views.

    Each point is (x, y, 1/z) in the present left camera. The loss is robust in the cost of a whole
    point: Huber's weight, and zero for outliers. Turn rates have a prior of mean zero: a weak one
    for the yaw of bodies that `may_turn` (B,), else one that all but fixes them.
    """
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    pixels = StereoPixels(
        np.ascontiguousarray(rig.T_cam1_cam0), np.array([f0[0], f0[1], f1[0], f1[1]]),
        noise.sigma_px, noise.drift_per_frame_px, noise.drift_per_flow,
    )  # fmt: skip
    dof = 4 * len(views.seen) - 3  # of a point that is seen in all views
    return refine_bodies_compiled(
        views, may_turn, pixels, settings.yaw_rate_sigma_rps, settings.tilt_rate_sigma_rps,
        gates(dof, 0.9), gates(dof, 0.999),
    )  # fmt: skip
