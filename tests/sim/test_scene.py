"""Movers tell their truth, and the boxes that are drawn lie inside it."""

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.sim.paths import straight_path, traffic_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.scene import Box, Mover, Scene, Texture, car_boxes, walker_boxes

ORIGIN = 1_500_000_000_000_000_000
PAINT = Texture(120.0, 40.0, 0.7, 3)
CAR, PERSON = np.array([4.4, 1.8, 1.45]), np.array([0.4, 0.6, 1.75])


def corners(box: Box) -> np.ndarray:
    signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    return se3.apply(box.T_body_box, signs * box.size)


@pytest.mark.parametrize(
    ("size", "boxes"), [(CAR, car_boxes(CAR, PAINT)), (PERSON, walker_boxes(PERSON, PAINT))]
)
def test_boxes_fill_their_size(size: np.ndarray, boxes: tuple[Box, ...]) -> None:
    points = np.concatenate([corners(box) for box in boxes])
    middle = np.array([0.0, 0.0, 0.5 * size[2]])
    np.testing.assert_allclose(points.max(axis=0)[:2], (middle + size / 2)[:2], atol=1e-9)
    assert np.all(np.abs(points - middle) <= size / 2 + 1e-9)


def test_state_matches_finite_differences_on_a_bend() -> None:
    road = Road(SmoothSteps.make((0.0, 0.03)), 80.0)
    path = traffic_path(
        road, SmoothSteps.make((0.0, 4.0), (3.0, 9.0)), ORIGIN, 4.0, start_m=5.0, offset_m=-2.0
    )
    mover = Mover(7, "car", CAR, car_boxes(CAR, PAINT), path)
    t, h = ORIGIN + 1_700_000_000, 1_000_000
    state, before, after = mover.state(t), mover.state(t - h), mover.state(t + h)
    slope = (after.center - before.center) / (2e-9 * h)
    np.testing.assert_allclose(state.velocity, slope, atol=1e-5)
    assert abs(state.yaw_rate - (after.yaw - before.yaw) / (2e-9 * h)) < 1e-5
    assert abs(np.arctan2(slope[1], slope[0]) - state.yaw) < 1e-4
    assert state.center[2] == pytest.approx(0.5 * CAR[2])


def test_placed_boxes_move_with_their_body() -> None:
    path = straight_path((0.0, 0.0), 0.0, SmoothSteps.make((0.0, 2.0)), ORIGIN, 3.0)
    mover = Mover(9, "car", CAR, car_boxes(CAR, PAINT), path)
    wall = Box(np.eye(4), np.ones(3), PAINT)
    scene = Scene((wall,), (mover,), PAINT, PAINT, np.array([0.0, 0.0, 1.0]))
    early, ids = scene.placed_boxes(ORIGIN)
    late, _ = scene.placed_boxes(ORIGIN + 1_500_000_000)
    assert ids == [0, 9, 9]
    assert early[0] is late[0]
    moved = [b.T_body_box[:3, 3] - a.T_body_box[:3, 3] for a, b in zip(early, late, strict=True)]
    np.testing.assert_allclose(moved, [[0, 0, 0], [3, 0, 0], [3, 0, 0]], atol=1e-9)
