"""Rigid motions of clustered points: what the compiled search takes and gives."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import IntArray
from ovmot.objects.clustering import MotionHistory
from ovmot.objects.rigid_kernel import Motions, SeenPoints, Tolerance, extract_motions_compiled
from ovmot.physics import MAX_YAW_RATE_RPS, gate
from ovmot.settings import ObjectSettings


def extract_motions(
    points: MotionHistory,
    index: IntArray,
    size: IntArray,
    rig: StereoRig,
    settings: ObjectSettings,
    rng: np.random.Generator,
) -> Motions:
    """The motions in clusters, `index` (K,) and `size` (G,), in the order they are found."""
    seen = SeenPoints(
        points.predicted, points.p_cam0, points.cov_cam0, points.history.now[points.index],
        points.weight, points.information, points.history.span_s,
    )  # fmt: skip
    # a rotation has three more unknowns, and must explain that much more
    tolerance = Tolerance(
        np.ascontiguousarray(rig.T_cam1_cam0), gate(4, 0.999), gate(3, 0.99), MAX_YAW_RATE_RPS,
        settings.accel_sigma_mps2, settings.min_points,
    )  # fmt: skip
    return extract_motions_compiled(seen, index, size, tolerance, rng)
