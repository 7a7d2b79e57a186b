"""Compiled medians over the nearest features in the image."""

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import part

NEAREST = 5
"""Neighbours in the image whose median is taken: two may be wrong."""


@part
def nearest_medians(uv: FloatArray, values: FloatArray, where: FloatArray) -> FloatArray:
    """Medians (M, k) of the values (N, k) of the `NEAREST` features around pixels `where` (M, 2).

    `uv` (N, 2): the features' pixels, N >= `NEAREST`. Every pair is looked at: for some hundred
    features that takes less than to build a tree.
    """
    n_values = values.shape[1]
    out = np.empty((len(where), n_values))
    nearest, distance = np.empty(NEAREST, dtype=np.int64), np.empty(NEAREST)
    for m in range(len(where)):
        u, v = where[m]
        distance[:] = np.inf
        for n in range(len(uv)):
            d = (uv[n, 0] - u) ** 2 + (uv[n, 1] - v) ** 2
            if d < distance[NEAREST - 1]:
                k = NEAREST - 1
                while k > 0 and distance[k - 1] > d:
                    distance[k], nearest[k] = distance[k - 1], nearest[k - 1]
                    k -= 1
                distance[k], nearest[k] = d, n
        for c in range(n_values):
            for k in range(NEAREST):  # sorted by insertion, in `distance`
                value, i = values[nearest[k], c], k
                while i > 0 and distance[i - 1] > value:
                    distance[i] = distance[i - 1]
                    i -= 1
                distance[i] = value
            out[m, c] = distance[NEAREST // 2]
    return out
