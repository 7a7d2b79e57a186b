"""Start positions against true projection."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.prediction import (
    fill_depths,
    flow_nearby,
    predict_pixels,
    predict_right,
    unexplained_flow,
)
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


@pytest.fixture
def rig() -> StereoRig:
    left = Camera.make((640, 400), (380.0, 375.0), (322.0, 197.0), "radtan", [-0.2, 0.05, 1e-3, 0])
    right = Camera.make((640, 400), (382.0, 377.0), (318.0, 203.0), "radtan", [-0.21, 0.04, 0, 0])
    turn = so3.exp(np.array([0.02, -0.03, 0.1]))
    return StereoRig(left, right, np.eye(4), se3.make(turn, np.array([0.4, 0.1, 0.02])))


@pytest.fixture
def motion() -> FloatArray:
    return se3.make(so3.exp(np.array([0.02, -0.05, 0.01])), np.array([0.2, -0.05, -0.7]))


@pytest.fixture
def points() -> FloatArray:
    rng = np.random.default_rng(0)
    z = rng.uniform(3.0, 40.0, 50)
    return np.column_stack([rng.uniform(-0.5, 0.5, 50) * z, rng.uniform(-0.3, 0.3, 50) * z, z])


def test_points_of_known_depth_are_predicted_exactly(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    uv, depth = predict_pixels(points[:, :2] / points[:, 2:], points, motion, rig.cam0)
    now = se3.apply(motion, points)
    np.testing.assert_allclose(uv, rig.cam0.project(now), atol=1e-9)
    np.testing.assert_allclose(depth, now[:, 2])


def test_points_of_unknown_depth_follow_the_rotation_alone(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    xy = points[:, :2] / points[:, 2:]
    uv, depth = predict_pixels(xy, np.full_like(points, np.nan), motion, rig.cam0)
    far = se3.apply(motion, 1e7 * points)
    np.testing.assert_allclose(uv, rig.cam0.project(far), atol=1e-3)
    assert np.isnan(depth).all()


def test_known_and_unknown_points_do_not_mix(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    xy, some = points[:, :2] / points[:, 2:], points.copy()
    some[::3] = np.nan
    uv, depth = predict_pixels(xy, some, motion, rig.cam0)
    exact, _ = predict_pixels(xy, points, motion, rig.cam0)
    known = np.isfinite(some[:, 0])
    np.testing.assert_allclose(uv[known], exact[known], rtol=1e-12)
    np.testing.assert_array_equal(np.isfinite(depth), known)
    assert np.linalg.norm(uv - exact, axis=1)[~known].max() > 5.0
    assert np.isfinite(uv).all()


def test_a_point_that_the_camera_has_passed_has_no_depth(rig: StereoRig) -> None:
    passed = np.array([[0.1, 0.0, 0.5]])
    T = se3.make(np.eye(3), np.array([0.0, 0.0, -1.0]))
    uv, depth = predict_pixels(passed[:, :2] / passed[:, 2:], passed, T, rig.cam0)
    assert np.isnan(depth).all()
    np.testing.assert_allclose(uv, rig.cam0.denormalize(np.array([[0.2, 0.0]])))


def test_the_right_view_of_a_known_depth(rig: StereoRig, points: FloatArray) -> None:
    uv = predict_right(points[:, :2] / points[:, 2:], points[:, 2], rig)
    true = rig.cam1.project(se3.apply(rig.T_cam1_cam0, points))
    np.testing.assert_allclose(uv, true, atol=1e-9)


def test_unknown_depths_come_from_neighbours_in_the_image() -> None:
    rng = np.random.default_rng(1)
    uv = rng.uniform(0.0, 300.0, (60, 2)) + np.repeat([[0.0, 0.0], [1000.0, 0.0]], 30, axis=0)
    depth = np.repeat([5.0, 20.0], 30)
    depth[[3, 40]] = 99.0  # one odd neighbour does not spoil a median
    given = depth.copy()
    given[[0, 1, 30, 31]] = np.nan
    out = fill_depths(uv, given, 12.0)
    assert out[[0, 1, 30, 31]].tolist() == [5.0, 5.0, 20.0, 20.0]
    known = np.isfinite(given)
    np.testing.assert_array_equal(out[known], given[known])
    assert np.isnan(given[0])  # the argument is left as it was


def test_with_too_few_known_depths_the_default_is_taken() -> None:
    uv = np.arange(12.0).reshape(6, 2)
    depth = np.array([np.nan, 3.0, 4.0, np.nan, 5.0, 6.0])
    assert fill_depths(uv, depth, 12.0).tolist() == [12.0, 3.0, 4.0, 12.0, 5.0, 6.0]
    assert fill_depths(uv, np.full(6, np.nan), 12.0).tolist() == [12.0] * 6
    assert fill_depths(uv[:0], depth[:0], 12.0).shape == (0,)


def test_only_flow_that_is_not_the_camera_s_is_predicted() -> None:
    static_uv = np.zeros((4, 2))
    found = np.array([[3.0, 4.0], [3.0, 4.0], [500.0, 0.0], [np.nan, 1.0]])
    explained = np.array([True, False, False, False])
    flow = unexplained_flow(found, static_uv, explained, 80.0)
    np.testing.assert_array_equal(flow, [[0.0, 0.0], [3.0, 4.0], [0.0, 0.0], [0.0, 0.0]])


def test_lost_points_are_expected_where_their_neighbours_went() -> None:
    """Seven of a body that goes 20 px right, one of them mismatched; the rest is static."""
    uv = np.array([[10.0 * k, 50.0] for k in range(8)] + [[300.0, 50.0 + k] for k in range(9)])
    static_uv, found = uv + 1.0, uv + 1.0
    found[:7] += [20.0, 0.0]
    found[2] += [0.0, 90.0]
    ok = np.ones(len(uv), dtype=np.bool_)
    ok[7] = False
    start = flow_nearby(uv, static_uv, found, ok, 5.0)
    np.testing.assert_allclose(start[7], static_uv[7] + [20.0, 0.0])
    assert np.isnan(np.delete(start, 7, axis=0)).all()
    assert np.isnan(flow_nearby(uv, static_uv, found, ok, 150.0)).all()  # nothing moves so far
