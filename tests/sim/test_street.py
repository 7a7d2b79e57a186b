"""What stands beside the road: houses, parked cars, poles, and none of it in the way."""

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.scene_file import load_scene
from ovmot.sim.street import away_from, furnish, ground, sky

STRAIGHT = Road(SmoothSteps.make((0.0, 0.0)), 80.0)


def test_a_seed_furnishes_the_street_the_same_way() -> None:
    scene = load_scene("demo")
    first, again, other = (
        furnish(STRAIGHT, scene.street, scene.light, 60.0, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )

    def places(boxes: object) -> list[list[float]]:
        return [box.T_body_box[:3, 3].tolist() for box in boxes]  # type: ignore[attr-defined]

    assert len(first) > 10
    assert places(first) == places(again) != places(other)


def test_what_stands_too_near_to_the_path_is_left_out() -> None:
    scene = load_scene("demo")
    boxes = furnish(STRAIGHT, scene.street, scene.light, 60.0, np.random.default_rng(1))
    times = 100_000_000 * np.arange(60, dtype=np.int64)
    position = np.stack([np.arange(60.0), np.zeros(60), np.ones(60)], axis=-1)
    path = PoseSpline.through(times, se3.make(np.broadcast_to(np.eye(3), (60, 3, 3)), position))
    kept = away_from(boxes, path, 1.0)
    assert 0 < len(kept) <= len(boxes)
    assert away_from(boxes, path, 1000.0) == ()
    assert away_from((), path, 1.0) == ()


def test_ground_is_dark_and_the_sky_smooth() -> None:
    light = load_scene("demo").light
    below, above = ground(light, np.random.default_rng(0)), sky(light, np.random.default_rng(0))
    assert (below.mean, above.mean) == (light.ground, light.sky)
    assert above.contrast < below.contrast
    assert above.softness == 1.0
