"""Simulations of scene files: seeds, sizes, ways of moving, and bodies that never touch."""

from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from outline_checks import apart, corners

from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim.render import camera_rays, render_image
from ovmot.sim.rides import CAMERA_HEIGHT_M
from ovmot.sim.scene_file import SCENES, SceneFile, load_scene
from ovmot.sim.scenes import ORIGIN_NS, make_simulation
from ovmot.sim.simulation import Simulation

SMALL = (160, 70)
scene_of = cache(load_scene)


def outlines(simulation: Simulation, time_ns: IntArray) -> dict[str, FloatArray]:
    """Corners (N, 4, 2) of the rig and of every mover at N times."""

    def at(T: FloatArray, size: FloatArray) -> FloatArray:
        return corners(T[:, :3, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0]), size)

    T_world_vehicle = simulation.path.pose(time_ns) @ se3.inverse(simulation.T_vehicle_imu)
    found = {"rig": at(T_world_vehicle, np.array([4.6, 1.9]))}
    for mover in simulation.scene.movers:
        found[f"{mover.category} {mover.object_id}"] = at(mover.path.pose(time_ns), mover.size)
    return found


def test_outlines_are_told_apart() -> None:
    square = corners(np.zeros(2), np.array(0.0), np.array([2.0, 2.0]))
    assert apart(square, square + np.array([2.1, 0.0]))
    assert not apart(square, square + np.array([1.9, 1.9]))
    turned = corners(np.array([2.3, 0.0]), np.array(0.25 * np.pi), np.array([2.0, 2.0]))
    assert not apart(square, turned)
    assert apart(square, turned + np.array([0.2, 0.0]))
    many = np.stack([square + np.array([2.1, 0.0]), square, turned])
    assert apart(np.stack([square] * 3), many).tolist() == [True, False, False]


def test_outlines_are_where_the_movers_say_that_they_are() -> None:
    simulation = make_simulation(scene_of("traffic"), seed=0)
    time_ns = ORIGIN_NS + 1_000_000_000 * np.arange(3)
    found = outlines(simulation, time_ns)
    for mover in simulation.scene.movers:
        for k, stamp in enumerate(time_ns.tolist()):
            state = mover.state(stamp)
            expected = corners(state.center, np.array(state.yaw), state.size)
            outline = found[f"{mover.category} {mover.object_id}"][k]
            np.testing.assert_allclose(outline, expected, atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", range(5))
def test_nothing_ever_touches(name: str, seed: int) -> None:
    scene = scene_of(name)
    simulation = make_simulation(scene, seed=seed)
    assert len(simulation.scene.movers) == len(scene.along) + len(scene.across)
    time_ns = ORIGIN_NS + 200_000_000 * np.arange(int(5 * scene.duration_s))
    for (a, outline), (b, other) in combinations(outlines(simulation, time_ns).items(), 2):
        touching = time_ns[~apart(outline, other)]
        assert len(touching) == 0, f"{a} and {b} at {1e-9 * (touching - ORIGIN_NS)} s"


@pytest.mark.parametrize("name", SCENES)
def test_a_seed_repeats_and_two_differ(name: str) -> None:
    def grey(seed: int) -> FloatArray:
        size = (128, 128) if name == "fisheye" else SMALL
        simulation = make_simulation(scene_of(name), seed=seed, size=size, duration_s=0.1)
        T_world_cam = simulation.path.pose(ORIGIN_NS) @ simulation.rig.T_imu_cam0
        rays = camera_rays(simulation.rig.cam0)
        image = render_image(simulation.scene, rays, T_world_cam, ORIGIN_NS)
        return np.concatenate([image.grey.ravel(), simulation.imu.gyro_bias])

    first = grey(0)
    np.testing.assert_array_equal(first, grey(0))
    assert np.mean(np.abs(first - grey(1)) > 1.0) > 0.2


def test_a_seed_moves_starts_and_speeds_within_the_jitter() -> None:
    scene = scene_of("traffic")
    plain = make_simulation(scene.model_copy(update={"jitter": scene.jitter.model_copy(
        update={"start_m": 0.0, "speed": 0.0})}), seed=0)  # fmt: skip
    shifts = []
    for seed in range(4):
        for mover, still in zip(
            make_simulation(scene, seed=seed).scene.movers, plain.scene.movers, strict=True
        ):
            at = mover.state(ORIGIN_NS).center - still.state(ORIGIN_NS).center
            shifts.append(float(np.linalg.norm(at)))
            late = ORIGIN_NS + 8_000_000_000
            fast = np.linalg.norm(still.state(late).velocity)
            change = np.linalg.norm(mover.state(late).velocity) - fast
            assert abs(change) <= 0.12 * fast + 0.05
    assert max(shifts) < 2.1
    assert np.mean(np.array(shifts) > 0.3) > 0.5


def test_a_jam_is_mostly_movers() -> None:
    simulation = make_simulation(scene_of("jam"), seed=0, size=SMALL)
    rays = camera_rays(simulation.rig.cam0)
    shares = []
    for time_ns in simulation.camera_ns[::20]:
        T_world_cam = simulation.path.pose(int(time_ns)) @ simulation.rig.T_imu_cam0
        image = render_image(simulation.scene, rays, T_world_cam, int(time_ns))
        shares.append((image.object_id > 0).mean())
    assert np.mean(shares) > 0.5
    speed = np.linalg.norm(simulation.path.velocity(simulation.camera_ns), axis=-1)
    still = speed < 0.02
    assert still[88:122].all()  # the full stop
    assert speed.max() > 3.0


def test_the_night_is_dark() -> None:
    simulation = make_simulation(scene_of("night"), seed=0, size=SMALL)
    rays = camera_rays(simulation.rig.cam0)
    T_world_cam = simulation.path.pose(ORIGIN_NS) @ simulation.rig.T_imu_cam0
    grey = render_image(simulation.scene, rays, T_world_cam, ORIGIN_NS).grey
    assert 28.0 < grey.mean() < 42.0
    assert simulation.optics.noise_grey >= 6.0


def test_a_longer_simulation_begins_as_a_shorter_one() -> None:
    scene = scene_of("traffic")
    short, long = (make_simulation(scene, seed=2, duration_s=d) for d in (1.0, 20.0))
    assert len(short.camera_ns) == 10
    assert len(long.camera_ns) == 200
    np.testing.assert_array_equal(short.camera_ns, long.camera_ns[:10])
    time_ns = int(short.camera_ns[-1])
    np.testing.assert_allclose(short.path.pose(time_ns), long.path.pose(time_ns))
    for a, b in zip(short.scene.movers, long.scene.movers, strict=True):
        np.testing.assert_allclose(a.state(time_ns).center, b.state(time_ns).center)


@pytest.mark.parametrize("path", ["stand", "walk", "drive"])
def test_other_ways_of_moving_keep_clear_too(path: str) -> None:
    simulation = make_simulation(scene_of("traffic"), seed=1, path=path, duration_s=12.0)
    speed = np.linalg.norm(simulation.path.velocity(simulation.camera_ns), axis=-1)
    assert {"stand": speed.max() < 1e-9, "walk": 0.8 < speed.max() < 2.0,
            "drive": speed.max() > 5.0}[path]  # fmt: skip
    height = (simulation.path.pose(ORIGIN_NS) @ simulation.rig.T_imu_cam0)[2, 3]
    assert 1.4 < height < 1.95
    ahead = (simulation.path.pose(ORIGIN_NS) @ simulation.rig.T_imu_cam0)[:3, 2]
    assert ahead[0] > 0.95
    assert len(simulation.scene.movers) >= 5
    if path != "walk":
        found = outlines(simulation, simulation.camera_ns[::2])
        rig = found.pop("rig")
        assert all(apart(rig, other).all() for other in found.values())


def recording(folder: Path, seconds: float, sink_m: float = 0.0) -> Path:
    """A TUM file at 20 Hz: 1 m/s north-west, the IMU's y axis ahead and its x axis up."""
    yaw = 2.4
    R_level = so3.exp(np.array([0.0, 0.0, yaw]))
    R_level_imu = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    q = so3.to_quaternion(R_level @ R_level_imu)
    rows = []
    for t in np.arange(0.0, seconds, 0.05):
        x, y = t * np.cos(yaw) + 50.0, t * np.sin(yaw) - 20.0
        row = (100.0 + t, x, y, 7.0 - sink_m * t / seconds, *q)
        rows.append(" ".join(f"{value:.9f}" for value in row))
    path = folder / "walk.tum"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_recorded_path_starts_at_the_rig_and_looks_where_it_goes(tmp_path: Path) -> None:
    scene = scene_of("traffic")
    simulation = make_simulation(scene, seed=0, path=str(recording(tmp_path, 10.0)))
    assert 70 < len(simulation.camera_ns) <= 80  # two margins of a second
    start, last = int(simulation.camera_ns[0]), int(simulation.camera_ns[-1])
    T_world_cam = simulation.path.pose(start) @ simulation.rig.T_imu_cam0
    assert T_world_cam[2, 3] == pytest.approx(CAMERA_HEIGHT_M, abs=1e-3)
    np.testing.assert_allclose(T_world_cam[:3, 2], [1.0, 0.0, 0.0], atol=0.03)
    np.testing.assert_allclose(T_world_cam[:3, 1], [0.0, 0.0, -1.0], atol=0.03)
    velocity = simulation.path.velocity(start)
    np.testing.assert_allclose(velocity, [1.0, 0.0, 0.0], atol=0.03)
    np.testing.assert_allclose(
        simulation.path.pose(start)[:2, 3], [scene.drive.start_m, scene.drive.offset_m], atol=1e-3
    )
    path = simulation.path.pose(np.arange(start, last, 100_000_000))[:, :3, 3]
    for box in simulation.scene.boxes:
        inside = np.abs(se3.apply(se3.inverse(box.T_body_box), path)) - 0.5 * box.size
        assert np.linalg.norm(np.maximum(inside, 0.0), axis=-1).min() >= 1.0


def test_a_recorded_path_that_leaves_or_ends_is_refused(tmp_path: Path) -> None:
    scene = scene_of("empty")
    with pytest.raises(InputError, match=r"walk\.tum: the camera, 1\.5 m above.*sinks to"):
        make_simulation(scene, seed=0, path=str(recording(tmp_path, 10.0, sink_m=2.5)))
    with pytest.raises(InputError, match=r"walk\.tum: .* s long"):
        make_simulation(scene, seed=0, path=str(recording(tmp_path, 10.0)), duration_s=9.0)
    with pytest.raises(InputError, match=r"nowhere\.tum"):
        make_simulation(scene, seed=0, path="nowhere.tum")


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 600.5, float("nan")])
def test_impossible_durations_are_refused(duration_s: float) -> None:
    with pytest.raises(InputError, match="choose more than 0 and at most 600 s"):
        make_simulation(scene_of("empty"), seed=0, duration_s=duration_s)


@pytest.mark.parametrize("rate_hz", [0.0, 0.5, 101.0, float("nan")])
def test_impossible_rates_are_refused(rate_hz: float) -> None:
    with pytest.raises(InputError, match="choose 1 to 100"):
        make_simulation(scene_of("empty"), seed=0, rate_hz=rate_hz)


def test_a_scene_whose_movers_touch_says_which_and_when() -> None:
    crash = SceneFile.model_validate({
        "duration_s": 5,
        "drive": {"speed": [[0, 5]]},
        "along": [{"start_m": 30, "offset_m": 1.7}, {"start_m": 20, "offset_m": -1.7,
                                                     "speed": [[0, 0]]}],
    })  # fmt: skip
    with pytest.raises(InputError, match=r"scene: along\.1 touches the rig at 2\.\d s"):
        make_simulation(crash, seed=0)
