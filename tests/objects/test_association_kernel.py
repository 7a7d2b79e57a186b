"""The compiled comparison of tracks with measurements equals its plain NumPy twin."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.association_kernel import Bodies, SeenParts, compare_compiled

PARTS = SeenParts(centre_share=0.25, least_sigma_m=0.2, drives_mps=3.0, car_length_m=4.5)
LEVEL = np.array([0, 1, 3, 4])


def bodies(rng: np.random.Generator, n: int) -> Bodies:
    A = rng.normal(0.0, 0.4, (n, 6, 6))
    x = rng.normal(0.0, 2.0, (n, 6))
    x[::2, 3:] *= 3.0  # some drive
    P = A @ A.swapaxes(-1, -2) + 0.1 * np.eye(6)
    return Bodies(x, P, rng.uniform(0.3, 5.0, (n, 3)), rng.uniform(0.0, 0.6, n))


def innovation_covariance(tracks: Bodies, i: int, measured: Bodies, j: int) -> FloatArray:
    size = np.maximum(tracks.size[i], measured.size[j])
    R = measured.covariance[j].copy()
    R[:3, :3] += max(0.25 * size.max(), 0.2) ** 2 * np.eye(3)
    S = tracks.covariance[i] + R * max(measured.seconds[j] / max(tracks.seconds[i], 1e-3), 1.0)
    v = tracks.x[i, 3:]
    speed = float(np.hypot(v[0], v[1]))
    if speed > PARTS.drives_mps:
        S[:3, :3] += (0.25 * max(4.5 - size[0], 0.0)) ** 2 * np.outer(v, v) / speed**2
    return np.asarray(S)


def test_distances_and_densities_of_all_pairs() -> None:
    rng = np.random.default_rng(1)
    tracks, measured = bodies(rng, 5), bodies(rng, 4)
    distance, log_density = compare_compiled(tracks, measured, PARTS)
    for i in range(5):
        for j in range(4):
            S, r = innovation_covariance(tracks, i, measured, j), measured.x[j] - tracks.x[i]
            assert distance[i, j] == pytest.approx(float(r @ np.linalg.solve(S, r)), rel=1e-8)
            level = multivariate_normal(cov=S[np.ix_(LEVEL, LEVEL)]).logpdf(r[LEVEL])
            assert log_density[i, j] == pytest.approx(float(level), rel=1e-8)
    speeds = np.hypot(tracks.x[:, 3], tracks.x[:, 4])
    assert (speeds > PARTS.drives_mps).any() and (speeds < PARTS.drives_mps).any()
