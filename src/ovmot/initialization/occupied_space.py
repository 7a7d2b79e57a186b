"""Which of the bodies in view is the world? The one that fills most room.

An IMU cannot tell the world from a truck that drives straight on at constant speed: seen from
either, the same forces act. Points cannot be counted either, since a near truck has most of them.
But no vehicle reaches as far and as wide as the street that it stands on.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import stereo_covariance, triangulate_stereo

PIXEL_SIGMA = 1.0  # of a stereo match
_CELL_M = 2.0
_MAX_DEPTH_ERROR = 0.1  # of the depth: what is farther off stands still for every motion


def space_filled(normalized: FloatArray, rig: StereoRig) -> int:
    """How many cubes of 2 m hold stereo points (N, 4) whose depth is known to a tenth."""
    p = triangulate_stereo(normalized, rig.T_cam1_cam0)
    p = p[np.isfinite(p).all(axis=1)]
    if not len(p):
        return 0
    C = stereo_covariance(p, rig.T_cam1_cam0, normalized_sigma(rig, PIXEL_SIGMA))
    p = p[np.sqrt(C[:, 2, 2]) < _MAX_DEPTH_ERROR * p[:, 2]]
    return len(np.unique(np.floor(p / _CELL_M).astype(np.int64), axis=0))


def normalized_sigma(rig: StereoRig, pixel_sigma: float) -> FloatArray:
    """Standard deviations (4,) of plane coordinates, left and right, of so many pixels."""
    f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
    return np.asarray(pixel_sigma / np.array([f0[0], f0[1], f1[0], f1[1]]))
