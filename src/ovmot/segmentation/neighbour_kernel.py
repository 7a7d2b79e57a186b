"""The compiled search for neighbours that move alike: a moving thing carries more than one point.

tests/segmentation/test_neighbour_kernel.py holds the plain NumPy twin.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part
from ovmot.kernels.small_matrices import squared_mahalanobis
from ovmot.kernels.sorting import sort_together

_MAX_NEIGHBOURS = 10


def count_alike(
    p: FloatArray,
    cov_p: FloatArray,
    velocity: FloatArray,
    cov_v: FloatArray,
    candidates: IntArray,
    kind: BoolArray,
    radius: float,
    turn_mps: float,
    gate: float,
) -> IntArray:
    """For each point (N,), how many near candidates have its velocity, of each kind: (N, K).

    `candidates` (M,): indices of the points that are compared; `kind` (N, K): of which kinds each
    point is. Positions p (N, 3) with covariance (N, 3, 3) and velocities (N, 3) with covariance
    (N, 3, 3) are in the left camera's axes. Depth is the poor direction of stereo: points are near
    when they are within `radius` metres across the rays, and along them within that and twice their
    sigma; of these the nearest count. Velocities agree within `gate` by their covariances and
    `turn_mps`, by which points of a turning body differ.
    """
    n, n_kinds = len(candidates), kind.shape[1]
    count = np.zeros((len(p), n_kinds), np.int64)
    near, apart = np.empty(_MAX_NEIGHBOURS, np.int64), np.empty(_MAX_NEIGHBOURS)
    # divided by its own reach, every direction is near within one unit
    scaled, C, dv = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    order, across, window = np.empty(n, np.int64), np.empty(n), np.zeros(2, np.int64)
    for k in range(n):
        order[k], across[k] = candidates[k], p[candidates[k], 0]
    sort_together(across, order, n)
    for k in range(n):
        i = order[k]
        scaled[k, 0], scaled[k, 1] = p[i, 0] / radius, p[i, 1] / radius
        scaled[k, 2] = p[i, 2] / (radius + 2.0 * math.sqrt(cov_p[i, 2, 2]))
    for k in range(n):
        i = order[k]
        while scaled[window[0], 0] < scaled[k, 0] - 1.0:
            window[0] += 1
        while window[1] < n and scaled[window[1], 0] <= scaled[k, 0] + 1.0:
            window[1] += 1
        within = scaled[window[0] : window[1]]
        for slot in range(nearest(within, k - window[0], near, apart)):
            j = order[window[0] + near[slot]]
            for a in range(3):
                dv[a] = velocity[i, a] - velocity[j, a]
                for b in range(3):
                    C[a, b] = cov_v[i, a, b] + cov_v[j, a, b] + (turn_mps**2 if a == b else 0.0)
            if squared_mahalanobis(dv, C) < gate:
                for of in range(n_kinds):
                    count[i, of] += kind[j, of]
    return count


@inlined_part
def nearest(scaled: FloatArray, k: int, near: IntArray, apart: FloatArray) -> int:
    """How many of the points (M, 3) are among the nearest to point k and within one unit of it.

    They are put into `near`, their squared distances into `apart`, in rising order.
    """
    found = 0
    for m in range(len(scaled)):
        d0, d1 = scaled[m, 0] - scaled[k, 0], scaled[m, 1] - scaled[k, 1]
        d2 = scaled[m, 2] - scaled[k, 2]
        d = d0 * d0 + d1 * d1 + d2 * d2
        if m == k or not d < 1.0 or (found == len(near) and d >= apart[found - 1]):
            continue
        found = min(found + 1, len(near))
        slot = found - 1
        while slot > 0 and apart[slot - 1] > d:
            near[slot], apart[slot] = near[slot - 1], apart[slot - 1]
            slot -= 1
        near[slot], apart[slot] = m, d
    return found


count_alike_compiled = compiled(count_alike, code_folder(Path(__file__)))
