"""Compiled loops over the features of a frame: their motions, and which go with a body.

tests/objects/test_features_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part
from ovmot.kernels.small_matrices import squared_mahalanobis
from ovmot.kernels.stereo import transform
from ovmot.kernels.table_kernel import rows_of_ids


def places_of(
    feature_id: IntArray, before: IntArray, place_before: IntArray, n_places: int
) -> tuple[IntArray, BoolArray]:
    """The place (N,) of each feature in a memory of `n_places`, and which are new there (N,).

    Those of the frame before, with ids `before` (M,), keep theirs, `place_before` (M,); new ones
    get the free ones in order.
    """
    at = rows_of_ids(feature_id, before)
    place, is_new, free = np.empty(len(at), np.int64), at < 0, np.ones(n_places, np.bool_)
    for n in range(len(at)):
        if not is_new[n]:
            place[n] = place_before[at[n]]
            free[place[n]] = False
    s = 0
    for n in range(len(at)):
        if is_new[n]:
            while not free[s]:
                s += 1
            place[n] = s
            s += 1
    return place, is_new


def feature_motions(
    p_cam0: FloatArray,
    cov_cam0: FloatArray,
    T_world_cam0: FloatArray,
    place: IntArray,
    is_new: BoolArray,
    age_s: FloatArray,
    now: int,
    memory_s: float,
    accel_mps2: float,
    p_kept: FloatArray,
    cov_kept: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Each feature's motion (N,) since the earlier time with the least expected squared error.

    The part of the positions' noise falls with the span, that of an acceleration grows. `p_kept`
    (S, T, 3) and `cov_kept` (S, T, 3, 3) hold earlier positions in world, feature n in `place`
    (N,), of times `age_s` (T,) ago; the present ones are put into row `now`, and those older than
    `memory_s` do not count. Returned are position, its covariance, velocity, its covariance, and
    the part of a possible acceleration in that variance; NaN where not known.
    """
    n_features = len(place)
    p, cov = np.empty((n_features, 3)), np.empty((n_features, 3, 3))
    velocity, velocity_cov = np.full((n_features, 3), np.nan), np.full((n_features, 3, 3), np.nan)
    change = np.full(n_features, np.nan)
    for n in range(n_features):
        s = place[n]
        if is_new[n]:
            p_kept[s, :, :] = np.nan
        transform(T_world_cam0, p_cam0[n], p[n])
        rotate_covariance(T_world_cam0, cov_cam0[n], cov[n])
        for a in range(3):
            p_kept[s, now, a] = p[n, a]
            for b in range(3):
                cov_kept[s, now, a, b] = cov[n, a, b]
        if not math.isfinite(p[n, 0]):
            continue
        best, least, trace = -1, np.inf, cov[n, 0, 0] + cov[n, 1, 1] + cov[n, 2, 2]
        for r in range(len(age_s)):
            dt = age_s[r]
            if r != now and dt <= memory_s and math.isfinite(p_kept[s, r, 0]):
                C = cov_kept[s, r]
                noise = (trace + C[0, 0] + C[1, 1] + C[2, 2]) / dt**2
                error = noise + 3.0 * (0.5 * accel_mps2 * dt) ** 2
                if error < least:
                    best, least = r, error
        if best >= 0:
            r, dt = best, age_s[best]
            change[n] = (0.5 * accel_mps2 * dt) ** 2
            for a in range(3):
                velocity[n, a] = (p[n, a] - p_kept[s, r, a]) / dt
                for b in range(3):
                    velocity_cov[n, a, b] = (cov[n, a, b] + cov_kept[s, r, a, b]) / dt**2
                velocity_cov[n, a, a] += change[n]
    return p, cov, velocity, velocity_cov, change


@inlined_part
def rotate_covariance(T: FloatArray, C: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = R C Rᵀ, R the rotation of T (4, 4)."""
    for a in range(3):
        x = T[a, 0] * C[0, 0] + T[a, 1] * C[1, 0] + T[a, 2] * C[2, 0]
        y = T[a, 0] * C[0, 1] + T[a, 1] * C[1, 1] + T[a, 2] * C[2, 1]
        z = T[a, 0] * C[0, 2] + T[a, 1] * C[1, 2] + T[a, 2] * C[2, 2]
        for b in range(3):
            out[a, b] = x * T[b, 0] + y * T[b, 1] + z * T[b, 2]


@part
def distance_of_velocity(
    velocity: FloatArray, covariance: FloatArray, of_body: FloatArray, of_body_cov: FloatArray,
    spread_mps: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Squared Mahalanobis distances of a feature's velocity (3,) from rest and from a body's, each
    with covariance (3, 3), and how far it is from the body's in m/s; infinite if not finite.

    Velocities of one body differ by `spread_mps` more.
    """
    if not math.isfinite(velocity[0]):
        return math.inf, math.inf, math.inf
    C, dv = np.empty((3, 3)), np.empty(3)
    for a in range(3):
        dv[a] = velocity[a]
        for b in range(3):
            C[a, b] = covariance[a, b] + (spread_mps**2 if a == b else 0.0)
    from_rest = squared_mahalanobis(dv, C)
    for a in range(3):
        dv[a] -= of_body[a]
        for b in range(3):
            C[a, b] += of_body_cov[a, b]
    off = math.sqrt(dv[0] ** 2 + dv[1] ** 2 + dv[2] ** 2)
    return from_rest, squared_mahalanobis(dv, C), off


@part
def distance_from_box(p: FloatArray, centre: FloatArray, size: FloatArray, yaw: float) -> float:
    """How far a point (3,) is from a box with a centre (3,), size (3,) and heading; 0 inside."""
    c, s = math.cos(yaw), math.sin(yaw)
    x, y, z = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    along = max(abs(c * x + s * y) - 0.5 * size[0], 0.0)
    across = max(abs(c * y - s * x) - 0.5 * size[1], 0.0)
    above = max(abs(z) - 0.5 * size[2], 0.0)
    if not math.isfinite(x + y + z):
        return math.inf
    return math.sqrt(along**2 + across**2 + above**2)


_FOLDER = code_folder(Path(__file__))
places_of_compiled = compiled(places_of, _FOLDER)
feature_motions_compiled = compiled(feature_motions, _FOLDER)
