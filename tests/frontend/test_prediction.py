"""Start positions against true projection."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.prediction import (
    Predicted,
    predict_right,
    predict_tracks,
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


def predicted(points: FloatArray, xy: FloatArray, motion: FloatArray, rig: StereoRig) -> Predicted:
    """Of features at rest, `points` NaN where unknown; too few are known to help each other."""
    nothing = np.zeros_like(xy)
    uv = rig.cam0.denormalize(xy)
    return predict_tracks(uv, xy, points, points, nothing, motion, rig.cam0)


def test_points_of_known_depth_are_predicted_exactly(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    seen = predicted(points, points[:, :2] / points[:, 2:], motion, rig)
    now = se3.apply(motion, points)
    np.testing.assert_allclose(seen.static_uv, rig.cam0.project(now), atol=1e-9)
    np.testing.assert_array_equal(seen.start, seen.static_uv)
    np.testing.assert_allclose(seen.depth, now[:, 2])
    assert not seen.moves.any()


def test_points_of_unknown_depth_follow_the_rotation_alone(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    xy = points[:, :2] / points[:, 2:]
    seen = predicted(np.full_like(points, np.nan), xy, motion, rig)
    far = se3.apply(motion, 1e7 * points)
    np.testing.assert_allclose(seen.static_uv, rig.cam0.project(far), atol=1e-3)
    assert np.isnan(seen.depth).all()


def test_one_of_unknown_depth_is_taken_at_that_of_its_neighbours(
    rig: StereoRig, motion: FloatArray
) -> None:
    xy = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 6), np.linspace(-0.2, 0.2, 4)), -1)
    xy = xy.reshape(-1, 2)
    wall = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * 7.0
    some = wall.copy()
    some[::5] = np.nan
    seen, exact = predicted(some, xy, motion, rig), predicted(wall, xy, motion, rig)
    np.testing.assert_allclose(seen.static_uv, exact.static_uv, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(seen.depth), np.isnan(some[:, 0]))


def test_a_point_that_the_camera_has_passed_has_no_depth(rig: StereoRig) -> None:
    passed = np.array([[0.1, 0.0, 0.5]])
    T = se3.make(np.eye(3), np.array([0.0, 0.0, -1.0]))
    seen = predicted(passed, passed[:, :2] / passed[:, 2:], T, rig)
    assert np.isnan(seen.depth).all()
    ahead = rig.cam0.denormalize(np.array([[0.2, 0.0]]))
    np.testing.assert_allclose(seen.static_uv, ahead)


def test_one_that_moves_on_its_own_is_sought_there(
    rig: StereoRig, motion: FloatArray, points: FloatArray
) -> None:
    """The others are sought where their flow beyond rest leads."""
    xy, own, extra = points[:, :2] / points[:, 2:], points.copy(), np.full((len(points), 2), 3.0)
    own[:10] += [0.5, 0.0, 1.0]
    uv = rig.cam0.project(points)
    seen = predict_tracks(uv, xy, points, own, extra, motion, rig.cam0)
    np.testing.assert_array_equal(seen.moves, np.arange(50) < 10)
    moved = rig.cam0.project(se3.apply(motion, own))
    np.testing.assert_allclose(seen.start[:10], moved[:10], atol=1e-9)
    np.testing.assert_allclose(seen.start[10:], seen.static_uv[10:] + 3.0, atol=1e-9)


def test_the_right_view_of_a_known_depth(rig: StereoRig, points: FloatArray) -> None:
    xy = points[:, :2] / points[:, 2:]
    uv = predict_right(rig.cam0.project(points), xy, points[:, 2], 9.0, rig)
    true = rig.cam1.project(se3.apply(rig.T_cam1_cam0, points))
    np.testing.assert_allclose(uv, true, atol=1e-9)


def test_unknown_depths_come_from_neighbours_in_the_image(rig: StereoRig) -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(-0.1, 0.1, (60, 2)) + np.repeat([[-0.4, 0.0], [0.4, 0.0]], 30, axis=0)
    uv, depth = rig.cam0.denormalize(xy), np.repeat([5.0, 20.0], 30)
    whole = predict_right(uv, xy, depth, 12.0, rig)
    depth[[3, 40]] = 99.0  # one odd neighbour does not spoil a median
    given = depth.copy()
    given[[0, 1, 30, 31]] = np.nan
    seen = predict_right(uv, xy, given, 12.0, rig)
    np.testing.assert_array_equal(seen[[0, 1, 30, 31]], whole[[0, 1, 30, 31]])
    assert np.isnan(given[0])  # the argument is left as it was


def test_with_too_few_known_depths_the_default_is_taken(rig: StereoRig) -> None:
    xy = 0.01 * np.arange(12.0).reshape(6, 2)
    uv, depth = rig.cam0.denormalize(xy), np.array([np.nan, 3.0, 4.0, np.nan, 5.0, 6.0])
    filled = np.array([12.0, 3.0, 4.0, 12.0, 5.0, 6.0])
    np.testing.assert_array_equal(
        predict_right(uv, xy, depth, 12.0, rig), predict_right(uv, xy, filled, 1.0, rig)
    )
    assert predict_right(uv[:0], xy[:0], depth[:0], 12.0, rig).shape == (0, 2)


def test_only_flow_that_is_not_the_camera_s_is_predicted() -> None:
    static_uv = np.zeros((4, 2))
    found = np.array([[3.0, 4.0], [3.0, 4.0], [500.0, 0.0], [np.nan, 1.0]])
    explained = np.array([True, False, False, False])
    flow = unexplained_flow(found, static_uv, explained, 80.0)
    np.testing.assert_array_equal(flow, [[0.0, 0.0], [3.0, 4.0], [0.0, 0.0], [0.0, 0.0]])
