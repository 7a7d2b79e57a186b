"""Data association: which measurement is of which track, by state and by common features."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.track import (
    CENTRE_SHARE,
    DRIVES_MPS,
    Track,
    centre_sigma,
    correlated_count,
    is_conclusive,
)
from ovmot.physics import CAR_SIZE_M, gate

_SHARED = 2  # common features by which a pair is possible in a wider gate


def associate(
    tracks: Sequence[Track],
    measurements: Sequence[ObjectMeasurement],
    out_of_view: BoolArray,
    now_ns: int,
) -> dict[int, int]:
    """Index of the measurement of each track that has one, by index of the track.

    `tracks` are predicted to now; `out_of_view` (T,): those that have left the image.
    """
    if not tracks or not measurements:
        return {}
    d = mahalanobis_distances(tracks, measurements, now_ns)
    share, count = common_features(
        [t.feature_id for t in tracks], [m.feature_id for m in measurements]
    )
    # a measurement with most of its features in another track is not of this one
    half = 0.5 * np.array([len(m.feature_id) for m in measurements])
    d[(count == 0) & (count.max(0) > half)] = np.inf
    # a track that has left the image is found again only by what would start one
    if out_of_view.any():
        inconclusive = ~np.array([is_conclusive(m) for m in measurements])
        d[out_of_view[:, None] & inconclusive & (count == 0)] = np.inf
    return dict(assign(d, share, count))


def mahalanobis_distances(
    tracks: Sequence[Track], measurements: Sequence[ObjectMeasurement], now_ns: int
) -> FloatArray:
    """Squared Mahalanobis distances (T, M) of measurements from predicted tracks, 6 degrees of
    freedom.

    What drives is longer than what may have been seen of it: after an occlusion its other end may
    come into view.
    """
    state = np.array([np.concatenate([t.position, t.velocity]) for t in tracks])
    P = np.array([t.covariance for t in tracks])
    value = np.array([np.concatenate([m.position, m.velocity]) for m in measurements])
    R = np.array([m.covariance for m in measurements])
    size = np.maximum(
        np.array([t.size for t in tracks])[:, None], np.array([m.size for m in measurements])
    )
    since = np.array([1e-9 * (now_ns - t.measured_ns) for t in tracks])
    correlated = correlated_count(np.array([m.span_s for m in measurements]), since[:, None])
    spread = np.zeros((len(tracks), len(measurements), 6, 6))
    spread[..., :3, :3] = (centre_sigma(size) ** 2)[..., None, None] * np.eye(3)
    S = P[:, None] + (R + spread) * correlated[..., None, None]
    v = state[:, 3:]
    speed = np.hypot(v[:, 0], v[:, 1])
    heading = np.where(speed > DRIVES_MPS, 1.0, 0.0)[:, None] * v / np.maximum(speed, 1e-9)[:, None]
    hidden = np.maximum(CAR_SIZE_M[0] - size[..., 0], 0.0) * CENTRE_SHARE
    S[..., :3, :3] += (hidden**2)[..., None, None] * (heading[:, :, None] * heading[:, None])[
        :, None
    ]
    r = value - state[:, None]
    distance: FloatArray = (r * np.linalg.solve(S, r[..., None])[..., 0]).sum(-1)
    return distance


def common_features(
    of_tracks: Sequence[IntArray], of_measurements: Sequence[IntArray]
) -> tuple[FloatArray, IntArray]:
    """Share (T, M), of the smaller set, and number (T, M) of common features.

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


def assign(distance: FloatArray, share: FloatArray, count: IntArray) -> list[tuple[int, int]]:
    """Pairs (track, measurement) of least total cost (Hungarian method).

    `distance` (T, M): squared Mahalanobis distances, 6 degrees of freedom; `share`, `count` (T, M):
    common features. A pair is possible within the gate, or with two common features within a wider
    one. A track without a measurement costs as much as the worst pair: none gives way to make
    another pair possible.
    """
    narrow, wide = gate(6, 0.999), gate(6, 1.0 - 1e-12)
    possible = (distance < narrow) | ((count >= _SHARED) & (distance < wide))
    cost = np.minimum(distance / narrow, 1.0) + (1.0 - share)
    tracks, measurements = linear_sum_assignment(np.where(possible, cost, 2.0))
    return [(int(i), int(j)) for i, j in zip(tracks, measurements, strict=True) if possible[i, j]]
