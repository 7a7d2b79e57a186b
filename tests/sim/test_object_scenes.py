"""The scenes of bodies that move alike, hide each other or are small: what makes each of them."""

from functools import cache

import numpy as np
import pytest

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim.render import camera_rays, render_image
from ovmot.sim.scene import Texture
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.sim.shapes import SIZES, body_boxes
from ovmot.sim.simulation import Simulation

SMALL = (160, 70)
SEEDS = range(3)


@cache
def simulation_of(name: str, seed: int) -> Simulation:
    return make_simulation(load_scene(name), seed=seed, size=SMALL)


def in_rig(simulation: Simulation, stamps: IntArray) -> dict[int, FloatArray]:
    """Where each mover's centre is, seen from the IMU: by id, (N, 3)."""
    T = se3.inverse(simulation.path.pose(stamps))
    return {
        mover.object_id: np.array([
            se3.apply(T[k], mover.state(t).center) for k, t in enumerate(stamps.tolist())
        ])
        for mover in simulation.scene.movers
    }  # fmt: skip


def visible(simulation: Simulation, stamps: IntArray) -> IntArray:
    """Pixels (N, 256) of each id in the left image."""
    rays = camera_rays(simulation.rig.cam0)
    images = [
        render_image(
            simulation.scene, rays, simulation.path.pose(t) @ simulation.rig.T_imu_cam0, t
        ).object_id
        for t in stamps.tolist()
    ]
    return np.array([np.bincount(ids.ravel(), minlength=256) for ids in images])


def speeds(simulation: Simulation, stamps: IntArray) -> dict[int, FloatArray]:
    """Speed of each mover by its id, (N,) m/s."""
    return {
        mover.object_id: np.linalg.norm(mover.path.velocity(stamps), axis=1)
        for mover in simulation.scene.movers
    }


@pytest.mark.parametrize("kind", SIZES)
def test_the_boxes_of_a_kind_fill_its_size(kind: str) -> None:
    size = 1.1 * SIZES[kind]
    ends = []
    for box in body_boxes(kind, size, Texture(100.0, 30.0, 0.7, 1)):
        ends += [box.T_body_box[:3, 3] - 0.5 * box.size, box.T_body_box[:3, 3] + 0.5 * box.size]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    np.testing.assert_allclose(high[:2], 0.5 * size[:2], rtol=1e-9)
    np.testing.assert_allclose(low[:2], -0.5 * size[:2], rtol=1e-9)
    assert high[2] == pytest.approx(size[2])
    assert 0.0 <= low[2] < 0.2 * size[2]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_queue_has_two_cars_a_lane_that_follow_each_other(seed: int) -> None:
    simulation = simulation_of("queue", seed)
    stamps = simulation.camera_ns[::20]
    at, size = in_rig(simulation, stamps), {m.object_id: m.size for m in simulation.scene.movers}
    assert np.abs(at[1][:, 0] - 11.5).max() < 3.0
    for rear, front in ((2, 3), (4, 5)):
        gap = np.linalg.norm(at[front] - at[rear], axis=1)
        gap -= 0.5 * (size[front][0] + size[rear][0])
        assert 2.0 < gap.min() < gap.max() < 6.5
        assert 3.0 < gap[0] < 5.0
        assert 4.0 < min(size[rear][0], size[front][0]) < max(size[rear][0], size[front][0]) < 5.0
        assert np.abs(at[front][:, 0] - 16.5).max() < 3.5
    rig = np.linalg.norm(simulation.path.velocity(stamps), axis=1)
    for speed in speeds(simulation, stamps).values():
        assert np.abs(speed - rig).max() < 1.0
    pixels = visible(simulation, stamps[:1])[0]
    for rear, front in ((2, 3), (4, 5)):
        whole = pixels[rear] * (at[rear][0, 0] / at[front][0, 0]) ** 2
        assert 0 < pixels[front] < 0.7 * whole


def test_sizes_differ_from_seed_to_seed() -> None:
    lengths = [
        [mover.size[0] for mover in simulation_of("queue", seed).scene.movers] for seed in SEEDS
    ]
    assert np.ptp(lengths, axis=0).min() > 0.01


@pytest.mark.parametrize("seed", SEEDS)
def test_cars_abreast_stay_side_by_side(seed: int) -> None:
    simulation = simulation_of("abreast", seed)
    stamps = simulation.camera_ns[::10]
    at, speed = in_rig(simulation, stamps), speeds(simulation, stamps)
    for a, b in ((1, 2), (3, 4), (5, 6), (7, 8)):
        apart = np.linalg.norm(at[a] - at[b], axis=1)
        assert 2.5 < apart.min() <= apart.max() < 4.0
        np.testing.assert_allclose(apart, apart[0], atol=1e-3)
        np.testing.assert_allclose(speed[a], speed[b], atol=1e-6)


def test_a_car_with_a_trailer_is_one_body() -> None:
    trailers = [
        m for m in simulation_of("trailer", 0).scene.movers if m.size[0] > 7.0
    ]  # fmt: skip
    assert len(trailers) == 3
    for mover in trailers:
        ends = sorted(
            (b.T_body_box[0, 3] - 0.5 * b.size[0], b.T_body_box[0, 3] + 0.5 * b.size[0])
            for b in mover.boxes if b.size[1] > 0.5
        )  # fmt: skip
        gap = ends[1][0] - ends[0][1]
        assert 0.8 < gap < 1.5  # the bar
        assert mover.category == "car"


@pytest.mark.parametrize("seed", SEEDS)
def test_walkers_arm_in_arm_have_no_gap(seed: int) -> None:
    simulation = simulation_of("arm_in_arm", seed)
    stamps = simulation.camera_ns[::20]
    at = in_rig(simulation, stamps)
    for a, b in ((1, 2), (3, 4), (5, 6), (7, 8)):
        apart = np.linalg.norm(at[a] - at[b], axis=1)
        assert 0.55 < apart.min() <= apart.max() < 0.8
        np.testing.assert_allclose(apart, apart[0], atol=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bus_hides_cars_that_come_out_again(seed: int) -> None:
    simulation = simulation_of("bus", seed)
    stamps = simulation.camera_ns[::4]
    pixels, speed = visible(simulation, stamps), speeds(simulation, stamps)
    for car in (3, 5):
        seen = np.flatnonzero(pixels[:, car] > 30)
        hidden = np.arange(seen[0], seen[-1])[pixels[seen[0] : seen[-1], car] == 0]
        assert 0 < len(hidden) < 8  # under 3 s
        if car == 5:  # it stands there when the bus is past
            assert speed[5][hidden[-1]] < 0.7
            still = (speed[5] < 0.1) & (pixels[:, 5] > 100)
            assert still.sum() >= 3
            assert speed[5][seen[-1]] > 3.0


def test_cyclists_are_small_and_faster_than_walkers() -> None:
    simulation = simulation_of("cyclists", 0)
    stamps = simulation.camera_ns[100:120:10]
    riders = [m for m in simulation.scene.movers if m.category == "cyclist"]
    assert len(riders) == 7
    for mover in riders:
        assert 1.6 < mover.size[0] < 1.9
        assert mover.size[1] < 0.6
        assert 2.5 < np.linalg.norm(mover.path.velocity(stamps), axis=1).max() < 9.0
