"""Which measurement belongs to which track: shared features and the predicted state decide."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import contained

_GATE = 22.5  # 99.9 % of chi-squared with 6 degrees of freedom
_SHARED = 2  # features that make a pair possible though the state says no
_SHARED_GATE = 3.0 * _GATE
_NONE = 2.0  # costs as much as the worst pair: no track gives way to make another one possible


def shared_share(
    of_tracks: Sequence[IntArray], of_measurements: Sequence[IntArray]
) -> tuple[FloatArray, IntArray]:
    """Share and number (T, M) of common features, as a share of the smaller set.

    Ids of tracks rise.
    """
    ids = np.concatenate(of_measurements)
    of = np.repeat(np.arange(len(of_measurements)), [len(b) for b in of_measurements])
    count = np.array(
        [np.bincount(of[contained(ids, a)], minlength=len(of_measurements)) for a in of_tracks]
    )
    n_a, n_b = np.array([len(a) for a in of_tracks]), np.array([len(b) for b in of_measurements])
    share = count / np.maximum(np.minimum(n_a[:, None], n_b), 1)
    return share, count


def associate(distance: FloatArray, share: FloatArray, count: IntArray) -> list[tuple[int, int]]:
    """Pairs (track, measurement) of least total cost.

    `distance` (T, M): squared Mahalanobis distance, 6 degrees of freedom. A pair is possible within
    its gate, or with two shared features and not absurdly far.
    """
    possible = (distance < _GATE) | ((count >= _SHARED) & (distance < _SHARED_GATE))
    cost = np.minimum(distance / _GATE, 1.0) + (1.0 - share)
    tracks, measurements = linear_sum_assignment(np.where(possible, cost, _NONE))
    return [(int(i), int(j)) for i, j in zip(tracks, measurements, strict=True) if possible[i, j]]
