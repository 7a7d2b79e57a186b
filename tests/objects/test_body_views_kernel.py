"""The compiled views of bodies, and where the refinement starts from, against plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray
from ovmot.objects.body_views_kernel import (
    BodyViews,
    MovingViews,
    body_views,
    body_views_compiled,
    row_between,
    twist_about,
)
from ovmot.objects.rigid_kernel import Motions
from ovmot.physics import gates


@pytest.mark.parametrize("kernel", [body_views, body_views_compiled])
def test_views_of_bodies(kernel: Callable[..., tuple[BodyViews, BoolArray]]) -> None:
    """Two bodies, one without a third view; the depths of the other do not differ enough."""
    rng = np.random.default_rng(2)
    p = rng.uniform([-2.0, -1.0, 5.0], [2.0, 1.0, 25.0], (6, 3))
    p[[4, 0, 2], 2] = 12.0, 12.1, 11.9
    moving = MovingViews(
        rng.normal(size=(3, 9, 4)), rng.normal(size=(9, 4)), np.array([0.8, 0.4, 0.1]),
        np.array([8, 4, 1]), np.array([1, 2, 4, 5, 7, 8]), p, np.tile(0.1 * np.eye(3), (6, 1, 1)),
        se3.exp(rng.normal(size=(5, 6))), np.array([0, 2, 3]), se3.exp(rng.normal(size=6)),
    )  # fmt: skip
    index, body = np.array([5, 3, 1, 4, 0, 2]), np.repeat([0, 1], 3)
    found = Motions(
        index, np.array([3, 3]), np.array([0, 1]), np.array([1, 0]),
        se3.exp(0.1 * rng.normal(size=(2, 6))), np.array([2, 0]),
    )  # fmt: skip
    views, may_turn = kernel(moving, found, gates(9, 0.99))
    T = moving.T_world_imu @ moving.T_imu_cam0
    rows, point = np.array([[2, 0], [2, 1]]), moving.point[index]
    seen = moving.then[rows[:, body], point]
    seen[1, :3] = np.nan
    np.testing.assert_array_equal(views.seen, [*seen, moving.now[point]])
    np.testing.assert_array_equal(views.p_cam0, p[index])
    assert views.body.tolist() == body.tolist()
    poses = np.stack([*T[moving.clone[rows]], T[[-1, -1]]])
    np.testing.assert_allclose(views.T_world_cam0, poses, atol=1e-13)
    np.testing.assert_array_equal(views.span_s, [*moving.span_s[rows], [0.0, 0.0]])
    np.testing.assert_array_equal(views.track_length, [*moving.n_frames[rows], [0.0, 0.0]])
    centre = p[index].reshape(2, 3, 3).mean(axis=1)
    np.testing.assert_allclose(views.origin, se3.apply(T[-1], centre), atol=1e-13)
    for b, span in enumerate(moving.span_s[found.row]):
        twist = np.empty(6)
        twist_about(found.T_now_then[b], T[-1], views.origin[b], float(span), twist)
        np.testing.assert_allclose(views.twist[b], twist, rtol=1e-9, atol=1e-12)
    assert may_turn.tolist() == [True, False]


def test_the_view_between_is_the_one_nearest_to_half_the_span() -> None:
    span_s = np.array([1.0, 0.7, 0.45, 0.1])
    assert [row_between(span_s, row) for row in range(4)] == [2, 2, 3, 3]


@pytest.mark.parametrize("angle", [0.0, 1e-6, 5e-4, 0.3, 2.5])
def test_twists_about_the_bodies(angle: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(4):
        turn, out = rng.normal(size=3), np.empty(6)
        turn *= angle / np.linalg.norm(turn)
        motion = se3.exp(np.hstack([turn, rng.normal(size=3)]))
        T, origin, span = se3.exp(rng.normal(size=6)), rng.normal(size=3), rng.uniform(0.1, 1.0)
        shift = se3.make(np.eye(3), origin)
        about = se3.inverse(shift) @ T @ motion @ se3.inverse(T) @ shift
        twist_about(motion, T, origin, span, out)
        np.testing.assert_allclose(out, se3.log(about) / span, rtol=1e-9, atol=1e-11)
