"""Laws of the optics: what is off changes nothing; brightness, blur and exposure as asked for."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.geometry.arrays import AnyArray
from ovmot.sim.optics import SUB_EXPOSURES, defocused, exposure_gains, sub_exposures
from ovmot.sim.render import camera_rays, expose, render_exposure, render_image, render_stereo
from ovmot.sim.scene_file import LightPart, load_scene
from ovmot.sim.scenes import ORIGIN_NS, make_simulation
from ovmot.sim.simulation import Optics, Simulation

TIMES = ORIGIN_NS + 100_000_000 * np.arange(600)


@pytest.fixture(scope="module")
def traffic() -> Simulation:
    return make_simulation(load_scene("traffic"), seed=0, size=(160, 70))


def moment(simulation: Simulation) -> int:
    """A time in full drive."""
    return int(simulation.camera_ns[70])


def test_all_is_off_by_default(traffic: Simulation) -> None:
    assert Optics() == Optics(2.0, 0.0, 0.0, 0.0)
    light = LightPart()
    assert light.exposure_drift == light.defocus_px == light.exposure_s == 0.0
    time_ns = moment(traffic)
    rays = camera_rays(traffic.rig.cam0)
    T_world_cam = traffic.path.pose(time_ns) @ traffic.rig.T_imu_cam0
    plain = render_image(traffic.scene, rays, T_world_cam, time_ns)
    off = render_exposure(traffic.scene, rays, traffic.path, traffic.rig.T_imu_cam0, time_ns, 0.0)
    np.testing.assert_array_equal(off.grey, plain.grey)
    noise = 2.0 * np.random.default_rng(1).standard_normal(plain.grey.shape, dtype=np.float32)
    image = expose(plain, Optics(), 1.0, np.random.default_rng(1))
    np.testing.assert_array_equal(image, np.clip(np.round(plain.grey + noise), 0, 255))


def test_gains_drift_slowly_within_their_bound_and_nearly_together() -> None:
    np.testing.assert_array_equal(exposure_gains(TIMES, 0.0, np.random.default_rng(0)), 1.0)
    for seed in range(5):
        gains = exposure_gains(TIMES, 0.2, np.random.default_rng(seed))
        assert gains.shape == (600, 2)
        assert np.abs(gains - 1.0).max() <= 0.2
        assert np.ptp(gains[:, 0]) > 0.08
        assert np.abs(np.diff(gains, axis=0)).max() < 0.04
        difference = np.abs(gains[:, 0] - gains[:, 1])
        assert 0.0 < difference.max() < 0.061
        again = exposure_gains(TIMES, 0.2, np.random.default_rng(seed))
        np.testing.assert_array_equal(again, gains)


def test_the_mean_follows_the_gain(traffic: Simulation) -> None:
    sky = replace(traffic.scene.sky, mean=150.0)  # bright images must not saturate
    scene = replace(traffic.scene, sky=sky)
    optics = Optics(noise_grey=0.0, exposure_drift=0.3)
    times = traffic.camera_ns[::25]

    def means(used: Optics) -> AnyArray:
        rng = np.random.default_rng(4)
        frames = render_stereo(scene, traffic.rig, traffic.path, times, used, rng)
        return np.array([[image.mean() for image in f.frame.pair] for f in frames])

    gains = exposure_gains(times, 0.3, np.random.default_rng(4).spawn(1)[0])
    assert np.ptp(gains) > 0.05
    np.testing.assert_allclose(means(optics) / means(Optics(0.0)), gains, atol=0.01)


def test_defocus_keeps_the_mean_and_spreads_a_point() -> None:
    point = np.zeros((61, 61), dtype=np.float32)
    point[30, 30] = 200.0
    assert defocused(point, 0.0) is point
    blurred = defocused(point, 2.0)
    assert blurred.sum() == pytest.approx(200.0, rel=1e-4)
    v, u = np.mgrid[:61, :61] - 30.0
    assert (blurred * u * u).sum() / 200.0 == pytest.approx(4.0, rel=0.03)
    assert (blurred * v * v).sum() / 200.0 == pytest.approx(4.0, rel=0.03)


def test_sub_exposures_surround_the_stamp() -> None:
    assert sub_exposures(ORIGIN_NS, 0.0) == [ORIGIN_NS]
    times = np.array(sub_exposures(ORIGIN_NS, 0.02)) - ORIGIN_NS
    np.testing.assert_array_equal(times, [-8_000_000, -4_000_000, 0, 4_000_000, 8_000_000])
    assert len(times) == SUB_EXPOSURES


def test_motion_blur_is_the_mean_of_its_moments_and_keeps_the_stamps_truth(
    traffic: Simulation,
) -> None:
    time_ns, T_imu_cam = moment(traffic), traffic.rig.T_imu_cam0
    rays = camera_rays(traffic.rig.cam0)
    blurred = render_exposure(traffic.scene, rays, traffic.path, T_imu_cam, time_ns, 0.03)
    moments = [
        render_image(traffic.scene, rays, traffic.path.pose(t) @ T_imu_cam, t)
        for t in sub_exposures(time_ns, 0.03)
    ]
    np.testing.assert_allclose(blurred.grey, np.mean([m.grey for m in moments], axis=0), atol=1e-3)
    middle = moments[SUB_EXPOSURES // 2]
    np.testing.assert_array_equal(blurred.depth, middle.depth)
    np.testing.assert_array_equal(blurred.object_id, middle.object_id)
    assert np.abs(blurred.grey - middle.grey).mean() > 0.1
    start_ns = int(traffic.camera_ns[0])
    walls = render_exposure(traffic.scene, rays, traffic.path, T_imu_cam, start_ns, 0.03)
    still = render_image(traffic.scene, rays, traffic.path.pose(start_ns) @ T_imu_cam, start_ns)
    unmoved = np.abs(walls.grey - still.grey) < 0.01
    assert unmoved.mean() > 0.75  # the rig stands; what moves is blurred all the same
    assert not unmoved.all()


def test_a_scene_switches_its_optics_on() -> None:
    scene = load_scene("night")
    light = scene.light.model_copy(update={"defocus_px": 1.5, "exposure_s": 0.02})
    simulation = make_simulation(scene.model_copy(update={"light": light}), seed=0)
    assert simulation.optics == Optics(6.5, 0.1, 1.5, 0.02)
