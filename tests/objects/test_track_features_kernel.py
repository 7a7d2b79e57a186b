"""The compiled questions of tracks about features equal their plain NumPy twins."""

import numpy as np
from body_twins import covariances

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.geometry.triangulation import squared_distance
from ovmot.objects.track_features_kernel import (
    Held,
    Hulls,
    Limits,
    Moving,
    alike_velocities_compiled,
    carried_by_compiled,
    joining_and_leaving_compiled,
    labelled_compiled,
    members_of,
    near_hulls_compiled,
    nearest_of_compiled,
    owners_of_compiled,
    recovering_compiled,
    spans_of_compiled,
)

T, N = 4, 120
LIMITS = Limits(0.5, 2.0, 0.2, 11.3, 1.0, 0.3, 9.2)
UNKNOWN, STATIC, DYNAMIC = 0, 1, 2


def scene(seed: int) -> tuple[Hulls, Moving]:
    """Tracks that drive in one direction and features, some with them, some at rest, in and around
    their boxes."""
    rng = np.random.default_rng(seed)
    v = np.array([4.0, 1.0, 0.0]) + rng.normal(0.0, 0.3, (T, 3))
    hulls = Hulls(
        rng.uniform(-3.0, 3.0, (T, 3)), rng.uniform(1.0, 4.0, (T, 3)), rng.uniform(-3.0, 3.0, T),
        rng.uniform(0.0, 0.3, T), v, covariances(rng, T, 0.3),
    )  # fmt: skip
    velocity = np.where(rng.random((N, 1)) < 0.5, v[rng.integers(0, T, N)], 0.0)
    velocity += rng.normal(0.0, 0.2, (N, 3))
    p = rng.uniform(-5.0, 5.0, (N, 3))
    velocity[3], p[4], velocity[4] = np.nan, np.nan, np.nan
    return hulls, Moving(p, covariances(rng, N, 0.2), velocity, covariances(rng, N, 0.3))


def outside(hulls: Hulls, p: FloatArray) -> FloatArray:
    """How far points are outside of each hull, along its axes: (T, N, 3)."""
    local = [(p - c) @ rotation_z(yaw) for c, yaw in zip(hulls.centre, hulls.yaw, strict=True)]
    return np.maximum(np.abs(local) - 0.5 * hulls.size[:, None], 0.0)


def near(hulls: Hulls, moving: Moving) -> BoolArray:
    reach = np.trace(moving.cov, axis1=1, axis2=2) + hulls.variance[:, None]
    distance = np.linalg.norm(outside(hulls, moving.p), axis=-1)
    return np.asarray(distance < LIMITS.margin_m + LIMITS.sigmas * np.sqrt(reach))


def from_rest_and_body(hulls: Hulls, moving: Moving) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Squared distances (T, N), infinite where not known, and which features move as a track."""
    wide = moving.velocity_cov + LIMITS.spread_mps**2 * np.eye(3)
    dv = moving.velocity - hulls.velocity[:, None]
    rest = np.broadcast_to(squared_distance(moving.velocity, wide), (T, N))
    body = squared_distance(dv, wide + hulls.velocity_cov[:, None])
    rest, body = (np.where(np.isfinite(a), a, np.inf) for a in (rest, body))
    reach = np.maximum(LIMITS.least_mps, LIMITS.share * np.linalg.norm(hulls.velocity, axis=1))
    same = (body < LIMITS.same) & (np.linalg.norm(dv, axis=-1) < reach[:, None])
    return rest, body, np.asarray(same & (rest > body + LIMITS.clearly))


def held_of(member: BoolArray) -> Held:
    """Features with ids 0, 7, 14, ... that tracks hold, and one that is out of view."""
    ids = [np.append(7 * np.flatnonzero(row), 5) for row in member]
    first = np.cumsum([0, *(len(own) for own in ids)])
    return Held(np.concatenate(ids), first)


def test_who_holds_a_feature() -> None:
    held = Held(np.array([5, 3, 9, 3, 100]), np.array([0, 2, 2, 5]))
    ids = np.array([3, 4, 5, 9])
    assert members_of(held, ids).tolist() == [
        [True, False, True, False], [False] * 4, [True, False, False, True]
    ]  # fmt: skip
    every, two = np.ones(3, np.bool_), np.array([True, True, False])
    assert owners_of_compiled(held, every, ids).tolist() == [2, -1, 0, 2]
    assert owners_of_compiled(held, two, ids).tolist() == [0, -1, 0, -1]


def test_what_moves_on_with_a_track() -> None:
    hulls, moving = scene(5)
    rng = np.random.default_rng(5)
    moving.velocity[rng.random(N) < 0.3] = np.nan
    member = rng.random((T, N)) < 0.1
    row = carried_by_compiled(held_of(member), 7 * np.arange(N), hulls, moving, LIMITS)
    carried = member | (near(hulls, moving) & np.isnan(moving.velocity[:, 0]))
    expected = np.where(carried, np.arange(T)[:, None], -1).max(axis=0)
    np.testing.assert_array_equal(row, expected)
    assert (row >= 0).any() and (row < 0).any()


def test_the_box_of_a_tracks_features() -> None:
    rng = np.random.default_rng(6)
    pixels, owner = rng.uniform(0.0, 500.0, (N, 4)), rng.integers(-1, T - 1, N)
    owner[0], owner[1] = T, T
    pixels[0, :2] = np.nan  # seen by the right camera alone
    box, count = spans_of_compiled(owner, pixels, T + 2)
    np.testing.assert_array_equal(count, np.bincount(owner[owner >= 0], minlength=T + 2))
    for t in range(T - 1):
        uv = pixels[owner == t, :2]
        np.testing.assert_array_equal(box[t], [*uv.min(axis=0), *uv.max(axis=0)])
    np.testing.assert_array_equal(box[T], np.tile(pixels[1, :2], 2))
    assert np.isnan(box[T + 1]).all()


def test_which_tracks_have_one_velocity() -> None:
    hulls, _ = scene(7)
    hulls.velocity[2] += 3.0
    found = alike_velocities_compiled(hulls, 0.3, 11.3)
    C = hulls.velocity_cov[:, None] + hulls.velocity_cov + 0.09 * np.eye(3)
    d = squared_distance(hulls.velocity[:, None] - hulls.velocity, C)
    np.testing.assert_array_equal(found, d < 11.3)
    assert 4 < found.sum() < 16


def test_what_is_near_and_what_moves_with_a_track() -> None:
    hulls, moving = scene(1)
    found = near_hulls_compiled(hulls, moving, LIMITS)
    np.testing.assert_array_equal(found, near(hulls, moving))
    assert 0.1 < found.mean() < 0.9
    moves = recovering_compiled(np.ones((T, N), np.bool_), hulls, moving, LIMITS)
    np.testing.assert_array_equal(moves, from_rest_and_body(hulls, moving)[2])
    assert 0.1 < moves.mean() < 0.9


def test_what_joins_and_what_leaves() -> None:
    hulls, moving = scene(2)
    rng = np.random.default_rng(2)
    member = rng.random((T, N)) < 0.2
    confirmed = np.array([True, True, False, False])
    coasting = np.array([False, False, False, True])
    joins, leaves = joining_and_leaving_compiled(
        held_of(member), 7 * np.arange(N), hulls, moving, confirmed, ~coasting, LIMITS
    )
    rest, body, moves = from_rest_and_body(hulls, moving)
    held, taken = member[~coasting].any(0), np.zeros(N, np.bool_)
    for t in range(T):
        static = ~coasting[t] & (rest[t] + LIMITS.clearly < body[t])
        out = member[t] & (taken | static)
        free = confirmed[t] & ~member[t] & ~held & ~taken
        into = free & near(hulls, moving)[t] & moves[t]
        np.testing.assert_array_equal(leaves[t], out)
        np.testing.assert_array_equal(joins[t], into)
        taken |= into | (member[t] & ~out)
    assert joins.sum() > 5 and leaves.sum() > 5
    assert not joins[~confirmed].any()


def test_labels_are_those_of_tracks_but_for_what_rests() -> None:
    hulls, moving = scene(3)
    rng = np.random.default_rng(3)
    label, owner = rng.integers(0, 3, N), rng.integers(-1, T, N)
    of_track = np.array([DYNAMIC, STATIC, -1, DYNAMIC])
    found = labelled_compiled(
        label, owner, of_track, hulls, moving, (STATIC, DYNAMIC, UNKNOWN), LIMITS
    )
    rest, body, _ = from_rest_and_body(hulls, moving)
    drives = near(hulls, moving) & (rest > body) & (of_track == DYNAMIC)[:, None]
    for n in range(N):
        t = owner[n]
        expected = label[n]
        if t < 0:
            slides = label[n] == STATIC and drives[:, n].any()
            expected = UNKNOWN if slides or label[n] == DYNAMIC else label[n]
        elif of_track[t] == STATIC:
            expected = STATIC
        elif of_track[t] == DYNAMIC:
            expected = UNKNOWN if rest[t, n] < body[t, n] else DYNAMIC
            expected = STATIC if rest[t, n] + LIMITS.clearly < body[t, n] else expected
        assert found[n] == expected
    assert len(set(found.tolist())) == 3


def test_a_point_is_of_the_nearest_hull_that_can_reach_it() -> None:
    hulls, _ = scene(4)
    rng = np.random.default_rng(4)
    p, sigma = rng.uniform(-5.0, 5.0, (N, 3)), rng.uniform(0.0, 0.5, N)
    rivals, greatest = np.array([True, True, False, True]), np.array([5.0, 4.5, 4.0])
    found = nearest_of_compiled(1, p, sigma, hulls, rivals, 2.5, greatest)
    away = outside(hulls, p)
    distance = np.linalg.norm(away, axis=-1)
    beyond = np.maximum(away[1] - 2.0 * sigma[:, None], 0.0)
    fits = (hulls.size[1] + beyond <= np.maximum(hulls.size[1], greatest)).all(1)
    fits &= beyond[:, :2].max(1) < 2.5
    nearest = (distance[1] <= distance[[0, 3]]).all(0)
    np.testing.assert_array_equal(found, fits & nearest)
    assert 0.05 < found.mean() < 0.95
