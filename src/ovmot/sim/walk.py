"""Hand-held walks: a person who carries the rig along a way, with steps, sway, looks and pauses.

The trunk rises and falls once a step and sways once a stride (two steps); at 1.3 m/s and 1.9 steps
a second the rise is some 4 cm from lowest to highest (S. Gard, S. Miff, A. Kuo, "Comparison of
kinematic and kinetic methods for computing the vertical motion of the body center of mass during
walking", Human Movement Science 2004).
"""

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.paths import knot_times, sines
from ovmot.sim.profiles import Road, SmoothSteps

WALKING_MPS = 1.3
STEP_HZ = 1.9
"""Steps a second at `WALKING_MPS`; a step's length stays, so slower walking has fewer."""
_FULL_STEPS_MPS = 0.8
_RISE_M, _SWAY_M, _SURGE_M = 0.02, 0.02, 0.008
_ROLL_RAD, _PITCH_RAD, _YAW_RAD = 0.02, 0.015, 0.03
_LOOK_RAD, _LOOK_HZ = 0.12, (0.05, 0.25)
_TREMOR_RAD, _TREMOR_M, _TREMOR_HZ = 0.003, 0.0015, (0.5, 3.0)
_START_S, _ACCELERATE_S, _TURN_S = 1.5, 1.2, 2.0


def walk_path(
    road: Road,
    speed: SmoothSteps,
    origin_ns: int,
    duration_s: float,
    rng: np.random.Generator,
    *,
    T_walker_body: FloatArray,
    start_m: float = 0.0,
    offset_m: float = 0.0,
) -> PoseSpline:
    """T_world_body of a rig that a person carries along the road, `offset_m` left of its middle.

    The walker's frame is x ahead, y left, z up, origin on the ground; `T_walker_body` (4, 4) says
    where the rig is held. `speed` is in m/s over seconds since `origin_ns`. Where it is zero the
    hands still tremble, and the look still wanders.
    """
    times, seconds = knot_times(origin_ns, duration_s)
    arc = speed.integral(seconds) - speed.integral(np.zeros(()))
    xy, yaw = road.at(start_m + arc, offset_m)
    effort = np.minimum(speed(seconds) / _FULL_STEPS_MPS, 1.0)[:, None]
    stride = np.pi * STEP_HZ / WALKING_MPS * arc + rng.uniform(0.0, 2.0 * np.pi)
    once, twice = np.sin(stride), np.sin(2.0 * stride)
    lag = np.sin(2.0 * stride + rng.uniform(0.0, 2.0 * np.pi))
    moved = effort * np.stack([_SURGE_M * lag, _SWAY_M * once, _RISE_M * twice], axis=-1)
    turned = effort * np.stack([_ROLL_RAD * once, _PITCH_RAD * lag, _YAW_RAD * once], axis=-1)
    tremor = np.stack([sines(seconds, rng, *_TREMOR_HZ) for _ in range(6)], axis=-1)
    moved = moved + _TREMOR_M * tremor[:, :3]
    turned = turned + _TREMOR_RAD * tremor[:, 3:]
    turned[:, 2] += _LOOK_RAD * sines(seconds, rng, *_LOOK_HZ)
    ground = np.concatenate([xy, np.zeros((len(xy), 1))], axis=-1)
    along = se3.make(so3.rotation_z(yaw), ground)
    return PoseSpline.through(times, along @ se3.make(so3.exp(turned), moved) @ T_walker_body)


def stroll(
    duration_s: float, rng: np.random.Generator, *, pause_share: float = 0.25
) -> tuple[Road, SmoothSteps]:
    """A random walk's way and speed: stretches of 5 to 12 s, each with a turn, some with a pause.

    It stands for 1.5 s, then walks; a stretch ends in a pause of 1 to 3 s with probability
    `pause_share`. Turns last 3 s and go up to 90 degrees to either side.
    """
    knots = [(_START_S, 0.0)]
    bends = [(0.0, 0.0)]
    time, arc = _START_S, 0.0
    while time < duration_s:
        pace, stretch = WALKING_MPS * rng.uniform(0.85, 1.15), rng.uniform(5.0, 12.0)
        was = knots[-1][1]
        knots += [(time + _ACCELERATE_S, pace), (time + stretch, pace)]
        arc += 0.5 * (was + pace) * _ACCELERATE_S + pace * (stretch - _ACCELERATE_S)
        time += stretch
        bend_m = _TURN_S * pace
        curvature = rng.uniform(-0.5 * np.pi, 0.5 * np.pi) / (0.75 * bend_m)  # its mean is half
        bends += [(arc - 1.5 * bend_m, 0.0), (arc - bend_m, curvature), (arc, 0.0)]
        if rng.uniform() < pause_share:
            knots.append((time + _ACCELERATE_S, 0.0))
            arc += 0.5 * pace * _ACCELERATE_S
            time += _ACCELERATE_S + rng.uniform(1.0, 3.0)
            knots.append((time, 0.0))
    return Road(SmoothSteps.make(*bends), arc + 1.0), SmoothSteps.make(*knots)
