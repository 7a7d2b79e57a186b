"""Compiled questions of all tracks about all features: who holds, joins, leaves, or rests.

tests/objects/test_track_features_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.small_matrices import squared_mahalanobis
from ovmot.kernels.table_kernel import rows_of_ids
from ovmot.objects.features_kernel import distance_from_box, distance_of_velocity


class Hulls(NamedTuple):
    """Of T tracks: centres and sizes (T, 3) of what was seen of them, headings (T,) and variances
    (T,) of their place; velocities (T, 3) with covariance (T, 3, 3)."""

    centre: FloatArray
    size: FloatArray
    yaw: FloatArray
    variance: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray


class Held(NamedTuple):
    """The features that T tracks hold: `ids` (K,), those of track t from `first[t]` on, up to
    `first[t + 1]`."""

    ids: IntArray
    first: IntArray


class Moving(NamedTuple):
    """Of N features: places (N, 3) in world and velocities (N, 3), each with covariance (N, 3, 3);
    NaN where not known."""

    p: FloatArray
    cov: FloatArray
    velocity: FloatArray
    velocity_cov: FloatArray


class Limits(NamedTuple):
    """A feature is near a box within `margin_m` and `sigmas` standard deviations. Velocities of one
    body differ by `spread_mps` and are within the squared distance `same`, nor by more than
    `least_mps` or this `share` of the body's; a motion that fits better by `clearly` is certain."""

    margin_m: float
    sigmas: float
    spread_mps: float
    same: float
    least_mps: float
    share: float
    clearly: float


@part
def members_of(held: Held, feature_id: IntArray) -> BoolArray:
    """Which features (N,) each track holds (T, N)."""
    out = np.zeros((len(held.first) - 1, len(feature_id)), np.bool_)
    at = rows_of_ids(held.ids, feature_id)
    for t in range(len(out)):
        for k in range(held.first[t], held.first[t + 1]):
            if at[k] >= 0:
                out[t, at[k]] = True
    return out


def owners_of(held: Held, holds: BoolArray, feature_id: IntArray) -> IntArray:
    """The row of the track that holds each feature (N,), of those that `holds` (T,) says hold any;
    -1 for none, and the last of several."""
    out = np.full(len(feature_id), -1, np.int64)
    at = rows_of_ids(held.ids, feature_id)
    for t in range(len(holds)):
        for k in range(held.first[t], held.first[t + 1]):
            if holds[t] and at[k] >= 0:
                out[at[k]] = t
    return out


@part
def is_near(hulls: Hulls, t: int, moving: Moving, n: int, limits: Limits) -> bool:
    """May feature n be in or near the hull of track t?"""
    C = moving.cov[n]
    sigma = math.sqrt(C[0, 0] + C[1, 1] + C[2, 2] + hulls.variance[t])
    distance = distance_from_box(moving.p[n], hulls.centre[t], hulls.size[t], hulls.yaw[t])
    return bool(distance < limits.margin_m + limits.sigmas * sigma)


def near_hulls(hulls: Hulls, moving: Moving, limits: Limits) -> BoolArray:
    """Which features (T, N) may be in or near the hull of each track."""
    out = np.zeros((len(hulls.yaw), len(moving.p)), np.bool_)
    for t in range(len(out)):
        for n in range(out.shape[1]):
            out[t, n] = is_near(hulls, t, moving, n, limits)
    return out


@part
def distances(
    hulls: Hulls, t: int, moving: Moving, n: int, limits: Limits
) -> tuple[float, float, float]:
    """Squared distances of feature n's velocity from rest and from that of track t, and m/s."""
    return distance_of_velocity(
        moving.velocity[n], moving.velocity_cov[n], hulls.velocity[t], hulls.velocity_cov[t],
        limits.spread_mps,
    )  # fmt: skip


@part
def moves_with(hulls: Hulls, t: int, moving: Moving, n: int, limits: Limits) -> bool:
    """Has feature n the velocity of track t, and is not at rest?

    Within the covariance of a body that is hardly known, everything around it would pass.
    """
    from_rest, from_body, off = distances(hulls, t, moving, n, limits)
    v = hulls.velocity[t]
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    same = from_body < limits.same and off < max(limits.least_mps, limits.share * speed)
    return bool(same and from_rest > from_body + limits.clearly)


def spans_of(owner: IntArray, pixels: FloatArray, n_tracks: int) -> tuple[FloatArray, IntArray]:
    """Boxes (T, 4) of the left pixels of T tracks' features: least u, v, greatest u, v; and the
    number (T,) of these. Of N features with `pixels` (N, 4), row `owner` (N,) holds each."""
    box, count = np.full((n_tracks, 4), np.nan), np.zeros(n_tracks, np.int64)
    for n in range(len(owner)):
        t = owner[n]
        if t >= 0:
            count[t] += 1
            for a in range(2):
                if math.isfinite(pixels[n, a]) and not pixels[n, a] >= box[t, a]:
                    box[t, a] = pixels[n, a]
                if math.isfinite(pixels[n, a]) and not pixels[n, a] <= box[t, 2 + a]:
                    box[t, 2 + a] = pixels[n, a]
    return box, count


def alike_velocities(hulls: Hulls, spread_mps: float, bound: float) -> BoolArray:
    """Which tracks (T, T) have one velocity: within a squared distance, `spread_mps` allowed."""
    T, dv, C = len(hulls.yaw), np.empty(3), np.empty((3, 3))
    out = np.ones((T, T), np.bool_)
    for s in range(T):
        for t in range(s):
            for a in range(3):
                dv[a] = hulls.velocity[s, a] - hulls.velocity[t, a]
                for b in range(3):
                    C[a, b] = hulls.velocity_cov[s, a, b] + hulls.velocity_cov[t, a, b]
                C[a, a] += spread_mps**2
            out[s, t] = out[t, s] = squared_mahalanobis(dv, C) < bound
    return out


def joining_and_leaving(
    of_tracks: Held, feature_id: IntArray, hulls: Hulls, moving: Moving, confirmed: BoolArray,
    seen: BoolArray, limits: Limits,
) -> tuple[BoolArray, BoolArray]:  # fmt: skip
    """Which features (T, N) join each track and which leave it.

    Free features near a confirmed track that move as it does and do not rest join it; those that
    clearly rest leave it. Of two tracks the older one keeps a common feature.
    """
    member = members_of(of_tracks, feature_id)
    T, N = member.shape
    joins, leaves = np.zeros((T, N), np.bool_), np.zeros((T, N), np.bool_)
    held, taken = np.zeros(N, np.bool_), np.zeros(N, np.bool_)
    for t in range(T):
        if seen[t]:
            held |= member[t]
    for t in range(T):
        for n in range(N):
            if member[t, n]:
                leaves[t, n] = taken[n]
                if seen[t] and not taken[n]:
                    from_rest, from_body, _ = distances(hulls, t, moving, n, limits)
                    leaves[t, n] = from_rest + limits.clearly < from_body
            elif confirmed[t] and not (held[n] or taken[n]):
                near = is_near(hulls, t, moving, n, limits)
                joins[t, n] = near and moves_with(hulls, t, moving, n, limits)
        for n in range(N):
            taken[n] |= joins[t, n] or (member[t, n] and not leaves[t, n])
    return joins, leaves


def carried_by(
    held: Held, feature_id: IntArray, hulls: Hulls, moving: Moving, limits: Limits
) -> IntArray:
    """The row of the track with which each feature (N,) moves on: the last one that holds it, or
    that it is near to, where its own motion is not known; -1 for none."""
    member, out = members_of(held, feature_id), np.full(len(feature_id), -1, np.int64)
    for t in range(len(member)):
        for n in range(len(out)):
            unknown = not math.isfinite(moving.velocity[n, 0])
            if member[t, n] or (unknown and is_near(hulls, t, moving, n, limits)):
                out[n] = t
    return out


def recovering(candidate: BoolArray, hulls: Hulls, moving: Moving, limits: Limits) -> BoolArray:
    """Which of the `candidate` features (T, N) move as their track does."""
    out = np.zeros(candidate.shape, np.bool_)
    for t in range(len(out)):
        for n in range(candidate.shape[1]):
            if candidate[t, n]:
                out[t, n] = moves_with(hulls, t, moving, n, limits)
    return out


def labelled(
    label: IntArray, owner: IntArray, of_track: IntArray, hulls: Hulls, moving: Moving,
    names: tuple[int, int, int], limits: Limits,
) -> IntArray:  # fmt: skip
    """Labels (N,) by tracks.

    `owner` (N,): the row of the track that holds each feature, -1 for none; `of_track` (T,): the
    label of its features, -1 where it gives none. `names`: of static, dynamic and unknown. Points
    at rest in a dynamic track, and static ones near it that move rather as it does, are unknown.
    """
    static, dynamic, unknown = names
    out = label.copy()
    for n in range(len(label)):
        t = owner[n]
        if t < 0 and label[n] == dynamic:
            out[n] = unknown
        elif t >= 0 and of_track[t] >= 0:
            out[n] = of_track[t]
            if of_track[t] == dynamic:
                from_rest, from_body, _ = distances(hulls, t, moving, n, limits)
                if from_rest + limits.clearly < from_body:
                    out[n] = static
                elif from_rest < from_body:
                    out[n] = unknown
        if t < 0 and out[n] == static:
            for k in range(len(of_track)):
                if of_track[k] == dynamic and is_near(hulls, k, moving, n, limits):
                    from_rest, from_body, _ = distances(hulls, k, moving, n, limits)
                    if from_rest > from_body:
                        out[n] = unknown
    return out


def nearest_of(
    i: int, p: FloatArray, sigma: FloatArray, hulls: Hulls, rivals: BoolArray, gap: float,
    greatest: FloatArray,
) -> BoolArray:  # fmt: skip
    """Which points (k, 3), with standard deviations (k,), may be of track i and are no nearer to
    the hulls of its `rivals` (T,).

    With each of them its hull must be no larger than `greatest` (3,), nor have a greater `gap`.
    """
    own, out = hulls.size[i], np.zeros(len(p), np.bool_)
    for k in range(len(p)):
        out[k] = fits_hull(p[k], 2.0 * sigma[k], hulls, i, gap, greatest)
        distance = distance_from_box(p[k], hulls.centre[i], own, hulls.yaw[i])
        for t in range(len(rivals)):
            if out[k] and rivals[t] and t != i:
                other = distance_from_box(p[k], hulls.centre[t], hulls.size[t], hulls.yaw[t])
                out[k] = distance <= other
    return out


@part
def fits_hull(
    p: FloatArray, slack: float, hulls: Hulls, i: int, gap: float, greatest: FloatArray
) -> bool:
    """May a point (3,), uncertain by `slack`, be of the body with hull i?"""
    c, s, d = math.cos(hulls.yaw[i]), math.sin(hulls.yaw[i]), hulls.centre[i]
    x, y, z = p[0] - d[0], p[1] - d[1], p[2] - d[2]
    offset, fits = (c * x + s * y, c * y - s * x, z), True
    for a in range(3):
        outside = max(max(abs(offset[a]) - 0.5 * hulls.size[i, a], 0.0) - slack, 0.0)
        fits &= hulls.size[i, a] + outside <= max(hulls.size[i, a], greatest[a])
        fits &= a == 2 or outside < gap
    return fits


_FOLDER = code_folder(Path(__file__))
spans_of_compiled = compiled(spans_of, _FOLDER)
alike_velocities_compiled = compiled(alike_velocities, _FOLDER)
owners_of_compiled = compiled(owners_of, _FOLDER)
carried_by_compiled = compiled(carried_by, _FOLDER)
joining_and_leaving_compiled = compiled(joining_and_leaving, _FOLDER)
near_hulls_compiled = compiled(near_hulls, _FOLDER)
recovering_compiled = compiled(recovering, _FOLDER)
labelled_compiled = compiled(labelled, _FOLDER)
nearest_of_compiled = compiled(nearest_of, _FOLDER)
