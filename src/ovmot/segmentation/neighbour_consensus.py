"""Neighbours that move alike: a moving thing carries more than one point."""

import numpy as np
from scipy.spatial import cKDTree

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.physics import CAR_SIZE_M, TURN_SPREAD_MPS, gate

_MAX_NEIGHBOURS = 10


def neighbours_with_same_velocity(
    p_cam0: FloatArray,
    cov_cam0: FloatArray,
    velocity: FloatArray,
    covariance: FloatArray,
    candidates: BoolArray,
) -> BoolArray:
    """Pairs (N, N) of candidates that are near each other and whose velocities agree.

    Positions (N, 3) and their covariance (N, 3, 3) are in the left camera, velocities (N, 3) with
    covariance (N, 3, 3) in m/s in its axes. Depth is the poor direction of stereo: points are near
    when they are within half a car's length across the rays, and along them within that and their
    sigmas.
    """
    alike = np.zeros((len(p_cam0), len(p_cam0)), dtype=np.bool_)
    index = np.flatnonzero(candidates)
    if len(index) < 2:
        return alike
    p, radius = p_cam0[index], 0.5 * CAR_SIZE_M[0]
    sigma_z = np.sqrt(cov_cam0[index, 2, 2])
    # Divided by its own reach, every direction is near within one unit.
    reach_z = radius + 2.0 * sigma_z
    scaled = np.column_stack([p[:, :2] / radius, p[:, 2] / reach_z])
    k = min(_MAX_NEIGHBOURS + 1, len(index))
    found = cKDTree(scaled).query(scaled, k=k, distance_upper_bound=1.0)
    apart, other = np.asarray(found[0]), np.asarray(found[1])
    a, slot = np.nonzero(np.isfinite(apart[:, 1:]))
    b = other[:, 1:][a, slot]
    dv = velocity[index[a]] - velocity[index[b]]
    C = covariance[index[a]] + covariance[index[b]] + TURN_SPREAD_MPS**2 * np.eye(3)
    agrees = (dv * np.linalg.solve(C, dv[..., None])[..., 0]).sum(-1) < gate(3, 0.99)
    alike[index[a[agrees]], index[b[agrees]]] = True
    return alike
