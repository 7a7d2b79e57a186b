"""The compiled predictions against their plain NumPy twins."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.lens_kernel import packed_camera
from ovmot.frontend.neighbour_kernel import NEAREST, nearest_medians
from ovmot.frontend.prediction_kernel import (
    LEAST_DEPTH_M,
    median_flow_compiled,
    other_places_compiled,
    predict_matches_compiled,
    predict_tracks_compiled,
)
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray

CAMERA = Camera.make((640, 400), (380.0, 375.0), (322.0, 197.0), "radtan", [-0.2, 0.05, 1e-3, 0])
T = se3.make(so3.exp(np.array([0.02, -0.05, 0.01])), np.array([0.2, -0.05, -1.7]))


def filled(uv: FloatArray, depth: FloatArray, default: float) -> FloatArray:
    """Depths with unknown ones from the median of the nearest known pixels."""
    known, out = np.isfinite(depth), depth.copy()
    out[~known] = default
    if known.sum() >= NEAREST:
        out[~known] = nearest_medians(uv[known], depth[known, None], uv[~known])[:, 0]
    return out


def seen(xy: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels and depths after the motion."""
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    near = se3.apply(T, p)
    usable = near[:, 2] > LEAST_DEPTH_M
    point = np.where(usable[:, None], near, ray @ T[:3, :3].T)
    return CAMERA.project(point), np.where(usable, near[:, 2], np.nan)


def predict_tracks_numpy(
    uv: FloatArray, xy: FloatArray, p: FloatArray, own: FloatArray, extra: FloatArray
) -> tuple[AnyArray, ...]:
    depth = filled(uv, p[:, 2], np.nan)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    static_uv, _ = seen(xy, np.where(np.isfinite(p), p, ray * depth[:, None]))
    start, depth = seen(xy, own)
    moves = np.isfinite(own[:, 0]) & (own != p).any(axis=1)
    return static_uv, np.where(moves[:, None], start, static_uv + extra), depth, moves


def flow_nearby_numpy(
    uv: FloatArray, static_uv: FloatArray, now: FloatArray, found: BoolArray, least_px: float
) -> FloatArray:
    start, extra = np.full(uv.shape, np.nan), now - static_uv
    moves = found & (np.linalg.norm(extra, axis=1) > least_px)
    if moves.sum() >= NEAREST and not found.all():
        start[~found] = static_uv[~found] + nearest_medians(uv[moves], extra[moves], uv[~found])
    return start


def features(n: int, known: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels, normalized coordinates and positions, a share of them known; some are passed."""
    rng = np.random.default_rng(n)
    xy = rng.uniform(-0.5, 0.5, (n, 2))
    p = np.concatenate([xy, np.ones((n, 1))], axis=1) * rng.uniform(1.0, 30.0, (n, 1))
    p[rng.uniform(size=n) > known] = np.nan
    return CAMERA.denormalize(xy), xy, p


@pytest.mark.parametrize(("n", "known"), [(0, 0.5), (6, 0.5), (80, 0.7), (80, 0.0), (80, 1.0)])
def test_tracks(n: int, known: float) -> None:
    uv, xy, p = features(n, known)
    own, extra = p.copy(), np.full((n, 2), 2.5)
    own[::4] += [0.3, 0.0, -0.5]
    compiled = predict_tracks_compiled(uv, xy, p, own, extra, T, *packed_camera(CAMERA))
    for a, b in zip(compiled, predict_tracks_numpy(uv, xy, p, own, extra), strict=True):
        np.testing.assert_allclose(np.asarray(a), b, rtol=1e-9)


@pytest.mark.parametrize(("n", "known"), [(0, 0.5), (6, 0.5), (80, 0.7), (80, 0.0)])
def test_matches(n: int, known: float) -> None:
    uv, xy, p = features(n, known)
    compiled = predict_matches_compiled(uv, xy, p[:, 2], 12.0, T, *packed_camera(CAMERA))
    ray = np.concatenate([xy, np.ones((n, 1))], axis=1)
    plain = CAMERA.project(se3.apply(T, ray * filled(uv, p[:, 2], 12.0)[:, None]))
    np.testing.assert_allclose(compiled, plain, rtol=1e-9)


@pytest.mark.parametrize("found_share", [0.0, 0.6, 1.0])
def test_other_places(found_share: float) -> None:
    rng = np.random.default_rng(2)
    uv = rng.uniform(0.0, 300.0, (60, 2))
    static_uv, found = uv + 1.0, rng.uniform(size=60) < found_share
    now = static_uv + rng.normal(0.0, 6.0, (60, 2))
    now[~found] = np.nan
    start = static_uv.copy()
    start[::3] += [0.0, 2.0]
    places = other_places_compiled(uv, static_uv, start, now, found, 5.0)
    np.testing.assert_allclose(places[0], flow_nearby_numpy(uv, static_uv, now, found, 5.0))
    elsewhere = np.full_like(uv, np.nan)
    elsewhere[::3] = static_uv[::3]
    np.testing.assert_array_equal(places[1], elsewhere)
    assert np.isnan(places[2]).all()
    far = static_uv if found.mean() < 0.5 else np.full_like(uv, np.nan)
    np.testing.assert_array_equal(places[3], far)


def test_lost_points_are_expected_where_their_neighbours_went() -> None:
    """Seven of a body that goes 20 px right, one of them mismatched; the rest is static."""
    uv = np.array([[10.0 * k, 50.0] for k in range(8)] + [[300.0, 50.0 + k] for k in range(9)])
    static_uv, now = uv + 1.0, uv + 1.0
    now[:7] += [20.0, 0.0]
    now[2] += [0.0, 90.0]
    found = np.ones(len(uv), dtype=np.bool_)
    found[7] = False
    start = other_places_compiled(uv, static_uv, static_uv, now, found, 5.0)[0]
    np.testing.assert_allclose(start[7], static_uv[7] + [20.0, 0.0])
    assert np.isnan(np.delete(start, 7, axis=0)).all()
    nothing_moves = other_places_compiled(uv, static_uv, static_uv, now, found, 150.0)[0]
    assert np.isnan(nothing_moves).all()


@pytest.mark.parametrize(("n", "known"), [(0, 0.5), (6, 0.5), (81, 0.7)])
def test_median_flow(n: int, known: float) -> None:
    _, xy, p = features(n, known)
    ray = np.concatenate([xy, np.ones((n, 1))], axis=1)
    now = np.where(np.isfinite(p), se3.apply(T, p), ray @ T[:3, :3].T)
    way = (now[:, :2] / now[:, 2:] - xy)[now[:, 2] > 0.0]
    expected = np.median(np.hypot(way[:, 0], way[:, 1])) if n else 0.0
    np.testing.assert_allclose(median_flow_compiled(xy, p, T), expected, rtol=1e-9)
