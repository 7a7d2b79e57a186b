"""Trajectories as SE(3) splines: the rig's drive, a standing rig, and the traffic around it.

Vehicle frame: x ahead, y to the left, z up, origin on the ground. Every path reaches `MARGIN_S`
beyond its first and last moment, so that IMU samples can surround the first and the last image.
"""

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.profiles import Road, SmoothSteps

MARGIN_S = 1.0
_KNOT_STEP_S = 0.05
_SQUAT_RAD_PER_MPS2 = 0.004
_FULL_VIBRATION_MPS = 4.0
_ROLL_RAD, _PITCH_RAD, _BOUNCE_M = 0.0025, 0.0035, 0.006
_LOWEST_HZ, _HIGHEST_HZ = 0.8, 2.6


def drive_path(
    road: Road,
    speed: SmoothSteps,
    origin_ns: int,
    duration_s: float,
    rng: np.random.Generator,
    *,
    T_vehicle_body: FloatArray,
    start_m: float = 0.0,
    offset_m: float = 0.0,
) -> PoseSpline:
    """T_world_body of a body on a vehicle that follows the road, with the motion of its springs.

    `speed` is in m/s over seconds since `origin_ns`, zero where it stands. Pitch, roll and bounce
    are sums of sines with random phases, scaled by the speed, and the nose dips when braking.
    """
    times, seconds = knot_times(origin_ns, duration_s)
    arc = start_m + speed.integral(seconds) - speed.integral(np.zeros(()))
    xy, yaw = road.at(arc, offset_m)
    shake = np.minimum(speed(seconds) / _FULL_VIBRATION_MPS, 1.0)
    roll, pitch, bounce = (
        size * shake * sines(seconds, rng, _LOWEST_HZ, _HIGHEST_HZ)
        for size in (_ROLL_RAD, _PITCH_RAD, _BOUNCE_M)
    )
    pitch = pitch - _SQUAT_RAD_PER_MPS2 * np.gradient(speed(seconds), seconds)
    R = so3.rotation_z(yaw) @ so3.exp(np.stack([roll, pitch, np.zeros_like(yaw)], axis=-1))
    T_world_vehicle = se3.make(R, np.concatenate([xy, bounce[:, None]], axis=-1))
    return PoseSpline.through(times, T_world_vehicle @ T_vehicle_body)


def traffic_path(
    road: Road,
    speed: SmoothSteps,
    origin_ns: int,
    duration_s: float,
    *,
    start_m: float,
    offset_m: float,
    oncoming: bool = False,
) -> PoseSpline:
    """T_world_vehicle of a car that follows the road `offset_m` left of its centre line.

    `speed` is that along the centre line; an oncoming car drives towards its start.
    """
    times, seconds = knot_times(origin_ns, duration_s)
    travelled = speed.integral(seconds) - speed.integral(np.zeros(()))
    xy, yaw = road.at(start_m + (-travelled if oncoming else travelled), offset_m)
    yaw = yaw + (np.pi if oncoming else 0.0)
    z = np.zeros((len(times), 1))
    return PoseSpline.through(
        times, se3.make(so3.rotation_z(yaw), np.concatenate([xy, z], axis=-1))
    )


def straight_path(
    start_xy: tuple[float, float],
    yaw: float,
    speed: SmoothSteps,
    origin_ns: int,
    duration_s: float,
) -> PoseSpline:
    """T_world_vehicle of a mover that goes straight, at `start_xy` at `origin_ns`."""
    times, seconds = knot_times(origin_ns, duration_s)
    travelled = speed.integral(seconds) - speed.integral(np.zeros(()))
    p = np.zeros((len(times), 3))
    p[:, 0] = start_xy[0] + travelled * np.cos(yaw)
    p[:, 1] = start_xy[1] + travelled * np.sin(yaw)
    return PoseSpline.through(times, se3.make(so3.rotation_z(np.full(len(times), yaw)), p))


def standing_path(T_world_body: FloatArray, origin_ns: int, duration_s: float) -> PoseSpline:
    """A body that rests at one pose (4, 4)."""
    times, _ = knot_times(origin_ns, duration_s)
    return PoseSpline.through(times, np.broadcast_to(T_world_body, (len(times), 4, 4)))


def knot_times(origin_ns: int, duration_s: float) -> tuple[IntArray, FloatArray]:
    """Knot times (N,) in ns, and the same in seconds since `origin_ns`."""
    count = int(np.ceil((duration_s + 2.0 * MARGIN_S) / _KNOT_STEP_S)) + 1
    since_ns = np.round(1e9 * (_KNOT_STEP_S * np.arange(count) - MARGIN_S)).astype(np.int64)
    return origin_ns + since_ns, np.asarray(1e-9 * since_ns)


def sines(
    seconds: FloatArray, rng: np.random.Generator, lowest_hz: float, highest_hz: float
) -> FloatArray:
    """Three sines of random frequency and phase, of standard deviation about one."""
    frequency = rng.uniform(lowest_hz, highest_hz, 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * frequency * seconds[:, None] + phase)
    return np.asarray(np.sqrt(2.0 / 3.0) * waves.sum(axis=-1))
