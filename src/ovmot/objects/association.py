"""Data association: which measurement is of which track, by state and by common features."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.objects.association_kernel import Bodies, SeenParts, compare_compiled
from ovmot.objects.body import LEAST_SEEN
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.track import (
    CENTRE_SHARE,
    DRIVES_MPS,
    LEAST_CENTRE_SIGMA_M,
    Track,
    TrackState,
)
from ovmot.physics import CAR_SIZE_M, ROAD_SPEED_SIGMA_MPS, ROAD_USER_AREA_M2, gate

_NEW = 0.1  # probability that a road user in view is not tracked yet
_SEEN_PARTS = SeenParts(CENTRE_SHARE, LEAST_CENTRE_SIGMA_M, DRIVES_MPS, CAR_SIZE_M[0])


def associate(
    tracks: Sequence[Track],
    measurements: Sequence[ObjectMeasurement],
    now_ns: int,
) -> dict[int, int]:
    """Index of the measurement of each track that has one, by index of the track.

    `tracks` are predicted to now.
    """
    if not tracks or not measurements:
        return {}
    d, log_density = compare_compiled(
        bodies_of(tracks, now_ns), bodies_measured(measurements), _SEEN_PARTS
    )
    share, count = common_features(
        [t.feature_id for t in tracks], [m.feature_id for m in measurements]
    )
    # a measurement with most of its features in another track is not of this one
    half = 0.5 * np.array([len(m.feature_id) for m in measurements])
    d[(count == 0) & (count.max(0) > half)] = np.inf
    # a lost track is found again by what is rather its own than that of a new body
    lost = np.array([t.state == TrackState.COASTING for t in tracks])
    if lost.any():
        rather_new = log_density < log_density_of_new(measurements)
        d[lost[:, None] & (count == 0) & rather_new] = np.inf
    return dict(assign(d, share, count))


def bodies_of(tracks: Sequence[Track], now_ns: int) -> Bodies:
    """The predicted tracks."""
    return Bodies(
        np.array([(*t.position, *t.velocity) for t in tracks]),
        np.array([t.covariance for t in tracks]),
        np.array([t.size for t in tracks]),
        np.array([1e-9 * (now_ns - t.measured_ns) for t in tracks]),
    )


def bodies_measured(measurements: Sequence[ObjectMeasurement]) -> Bodies:
    """The bodies of the measurements."""
    return Bodies(
        np.array([(*m.position, *m.velocity) for m in measurements]),
        np.array([m.covariance for m in measurements]),
        np.array([m.size for m in measurements]),
        np.array([m.span_s for m in measurements]),
    )


def log_density_of_new(measurements: Sequence[ObjectMeasurement]) -> FloatArray:
    """Logarithm (M,) of the density of measurements of new road users, which may be anywhere, at
    road users' velocities; over the level place and velocity."""
    v = np.array([m.velocity[:2] for m in measurements])
    C = np.array([m.covariance[3:5, 3:5] for m in measurements])
    C = C + np.diag(np.square(ROAD_SPEED_SIGMA_MPS[:2]))
    _, log_det = np.linalg.slogdet(2.0 * np.pi * C)
    squared = (v * np.linalg.solve(C, v[..., None])[..., 0]).sum(-1)
    return np.asarray(np.log(_NEW / ROAD_USER_AREA_M2) - 0.5 * (squared + log_det))


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
    common features. A pair is possible within the gate, or with so many common features as show a
    body within a wider one. A track without a measurement costs as much as the worst pair: none
    gives way to make another pair possible.
    """
    narrow, wide = gate(6, 0.999), gate(6, 1.0 - 1e-12)
    possible = (distance < narrow) | ((count >= LEAST_SEEN) & (distance < wide))
    cost = np.minimum(distance / narrow, 1.0) + (1.0 - share)
    tracks, measurements = linear_sum_assignment(np.where(possible, cost, 2.0))
    return [(int(i), int(j)) for i, j in zip(tracks, measurements, strict=True) if possible[i, j]]
