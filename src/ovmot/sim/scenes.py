"""Simulations made of scene files: `make_simulation`."""

from pathlib import Path

import numpy as np

from ovmot.errors import InputError
from ovmot.sim.imu_errors import NO_ERRORS, ImuErrors
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.rides import Ride, RideMaker, planned, random_drive, recorded, standing, walk
from ovmot.sim.rigs import named_rig, resized
from ovmot.sim.scene import Scene
from ovmot.sim.scene_file import MAX_DURATION_S, SceneFile, load_scene
from ovmot.sim.simulation import ImuModel, Optics, Simulation
from ovmot.sim.street import away_from, furnish, ground, sky
from ovmot.sim.traffic import carrier_outline, check_times, make_movers
from ovmot.types import ImuNoise

ORIGIN_NS = 1_500_000_000_000_000_000
_IMU_NOISE = ImuNoise(gyro=1.7e-4, gyro_walk=2e-5, accel=2e-3, accel_walk=3e-4)
_GYRO_BIAS_RPS, _ACCEL_BIAS_MPS2 = 3e-3, 3e-2
_SIGHT_M = 60.0
_LEAST_DISTANCE_M = 1.0
_STREAM = 1
"""Keeps the scene's random numbers apart from those of `sequence_files.generators`."""
_RIDES: dict[str, RideMaker] = {"stand": standing, "walk": walk, "drive": random_drive}


def make_simulation(
    scene: SceneFile,
    *,
    seed: int,
    path: str | None = None,
    size: tuple[int, int] | None = None,
    rate_hz: float | None = None,
    duration_s: float | None = None,
) -> Simulation:
    """The scene as one seed makes it: textures, parked cars, poles, movers, vibration, biases.

    `path` says how the rig moves: None as the scene has it; "stand"; "walk", in a person's hands;
    "drive", with random speeds and stops; else the TUM file of a recorded motion (`recorded`).
    Movers that such a rig, or a drive longer than the scene's, would run into are left out, and so
    is what stands nearer than 1 m to the rig's path. `size` (width, height) in pixels, `rate_hz`
    and `duration_s` replace the scene's. Raises `InputError` for values out of range.
    """
    rate = scene.rate_hz if rate_hz is None else rate_hz
    duration = scene.duration_s if duration_s is None else duration_s
    _refuse_times(rate, duration)
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence([seed, _STREAM]).spawn(4)]
    ride_rng, street_rng, mover_rng, imu_rng = streams
    rig = named_rig(scene.rig)
    if size is not None:
        rig = resized(rig, size)
    road = Road(SmoothSteps.make(*scene.road.curvature), scene.road.length_m)
    make_ride = _ride_maker(path, whole=duration_s is None)
    horizon_s = max(duration, scene.duration_s) if path is None else duration
    ride = make_ride(rig, road, scene.drive, ORIGIN_NS, horizon_s, ride_rng)
    if path is not None and path not in _RIDES:
        horizon_s = duration = min(duration, 1e-9 * (ride.path.end_ns - ORIGIN_NS) - 1.0)
    light = scene.light
    changed = path is not None or duration > scene.duration_s
    return Simulation(
        _scene(scene, road, ride, horizon_s, (street_rng, mover_rng), changed=changed),
        ride.rig,
        ride.path,
        ORIGIN_NS + np.round(1e9 / rate * np.arange(_frames(duration, rate))).astype(np.int64),
        ride.T_vehicle_imu,
        _imu(scene, imu_rng),
        Optics(light.noise_grey, light.exposure_drift, light.defocus_px, light.exposure_s),
    )


def demo_simulation(seed: int = 0, duration_s: float = 8.0, rate_hz: float = 10.0) -> Simulation:
    """The catalog's `demo`."""
    return make_simulation(load_scene("demo"), seed=seed, duration_s=duration_s, rate_hz=rate_hz)


def _ride_maker(path: str | None, *, whole: bool) -> RideMaker:
    if path is None:
        return planned
    return _RIDES[path] if path in _RIDES else recorded(Path(path), whole=whole)


def _frames(duration_s: float, rate_hz: float) -> int:
    return max(round(duration_s * rate_hz), 1)


def _refuse_times(rate_hz: float, duration_s: float) -> None:
    if not 0.0 < duration_s <= MAX_DURATION_S:
        remedy = f"choose more than 0 and at most {MAX_DURATION_S:g} s"
        raise InputError(f"duration of {duration_s:g} s: {remedy}")
    if not 1.0 <= rate_hz <= 100.0:
        raise InputError(f"rate of {rate_hz:g} frames a second: choose 1 to 100")


def _scene(
    scene: SceneFile, road: Road, ride: Ride, horizon_s: float,
    rngs: tuple[np.random.Generator, np.random.Generator], *, changed: bool,
) -> Scene:  # fmt: skip
    light = scene.light
    look_rng, street_rng = rngs[0].spawn(2)
    driven_m = float(ride.speed.integral(np.array(horizon_s)) - ride.speed.integral(np.zeros(())))
    reach_m = max(road.length_m, scene.drive.start_m + driven_m + _SIGHT_M)
    times = check_times(ORIGIN_NS, horizon_s)
    carrier = carrier_outline(ride.path, ride.T_vehicle_imu, times, ride.carrier_size)
    movers = make_movers(
        scene, road, ride.speed, carrier, times, rngs[1], leave_out=changed
    )  # fmt: skip
    boxes = furnish(road, scene.street, light, reach_m, street_rng)
    return Scene(
        away_from(boxes, ride.path, _LEAST_DISTANCE_M),
        movers, ground(light, look_rng), sky(light, look_rng), np.array(light.sun),
    )  # fmt: skip


def _imu(scene: SceneFile, rng: np.random.Generator) -> ImuModel:
    return ImuModel(
        scene.imu.rate_hz, _IMU_NOISE,
        rng.normal(0.0, _GYRO_BIAS_RPS, 3), rng.normal(0.0, _ACCEL_BIAS_MPS2, 3),
        ImuErrors.random(rng) if scene.imu.errors else NO_ERRORS,
    )  # fmt: skip
