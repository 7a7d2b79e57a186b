"""The movers of a scene: their shapes, their ways, and that none of them touches another.

A seed shifts and slows or hurries each mover. It is drawn again, and with less freedom, until the
mover's outline on the ground stays clear of the rig's and of all other movers'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.paths import straight_path, traffic_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.scene import Box, Mover
from ovmot.sim.scene_file import AcrossPart, AlongPart, SceneFile
from ovmot.sim.shapes import CATEGORIES, SIZES, body_boxes, texture_cell
from ovmot.sim.street import paint, texture_seed

CLEARANCE_M = 0.4
"""Least gap between the outlines of two bodies."""
_CHECK_STEP_S = 0.2
_DRAWS = 8
_SHARES = (1.0, 0.6, 0.3, 0.1, 0.0)
"""Of the jitter that is tried, until nothing touches."""


@dataclass(frozen=True, slots=True)
class Outline:
    """A body's rectangle on the ground over N times: middle (N, 2), yaw (N,), length and width."""

    xy: FloatArray
    yaw: FloatArray
    length: float
    width: float

    @classmethod
    def along(cls, path: PoseSpline, times: IntArray, size: FloatArray) -> "Outline":
        """Of a body whose middle is the path's and whose x axis is its length."""
        T = path.pose(times)
        yaw = np.arctan2(T[:, 1, 0], T[:, 0, 0])
        return cls(T[:, :2, 3], yaw, float(size[0]), float(size[1]))


def touching(a: Outline, b: Outline, gap_m: float = 0.0) -> BoolArray:
    """Whether (N,) two rectangles come nearer than `gap_m`: the separating axis theorem.

    With a gap it is strict: near two corners it can call them touching a bit farther apart.
    """
    apart = np.zeros(len(a.xy), dtype=bool)
    ends = b.xy - a.xy
    for yaw in (a.yaw, a.yaw + 0.5 * np.pi, b.yaw, b.yaw + 0.5 * np.pi):
        between = np.abs(np.cos(yaw) * ends[:, 0] + np.sin(yaw) * ends[:, 1])
        radius = sum(
            0.5 * body.length * np.abs(np.cos(yaw - body.yaw))
            + 0.5 * body.width * np.abs(np.sin(yaw - body.yaw))
            for body in (a, b)
        )
        apart |= between > radius + gap_m
    return ~apart


def check_times(origin_ns: int, duration_s: float) -> IntArray:
    """Times (N,) at which outlines are held apart."""
    count = int(duration_s / _CHECK_STEP_S) + 1
    return origin_ns + round(1e9 * _CHECK_STEP_S) * np.arange(count, dtype=np.int64)


def make_movers(
    scene: SceneFile,
    road: Road,
    rig_speed: SmoothSteps,
    rig: Outline,
    times: IntArray,
    rng: np.random.Generator,
    *,
    leave_out: bool,
) -> tuple[Mover, ...]:
    """The scene's movers; `rig` is the outline of what carries the cameras at `times` (N,).

    With `leave_out`, for a rig that does not drive as the scene's author thought, a mover that
    finds no free way is left out; without, it raises `InputError` where even the scene without
    jitter has movers that touch.
    """
    way = _Way(road, rig_speed, times)
    parts: list[AlongPart | AcrossPart] = [*scene.along, *scene.across]
    *look_rngs, size_rng = rng.spawn(len(parts) + 1)
    sizes = _sizes(parts, scene.jitter.size, size_rng)
    looks = [
        _look(scene, part, size, own)
        for part, size, own in zip(parts, sizes, look_rngs, strict=True)
    ]
    draws = rng.uniform(-1.0, 1.0, (len(parts), _DRAWS, 2))
    for share in _SHARES:
        jitter = share * draws * (scene.jitter.start_m, scene.jitter.speed)
        placed, blocked = _place(parts, sizes, jitter, way, rig)
        if leave_out or not blocked:
            break
    if blocked and not leave_out:
        raise InputError(_collision(scene, sizes, blocked[0], way, rig, placed))
    return tuple(
        Mover(i + 1, CATEGORIES[parts[i].kind], sizes[i], looks[i], placed[i])
        for i in sorted(placed)
    )


@dataclass(frozen=True, slots=True)
class _Way:
    """What all movers' paths depend on."""

    road: Road
    rig_speed: SmoothSteps
    times: IntArray

    def path(self, part: AlongPart | AcrossPart, shift_m: float, share: float) -> PoseSpline:
        """The part's path, begun `shift_m` farther on, its speed changed by a share."""
        duration_s = 1e-9 * float(self.times[-1] - self.times[0]) + _CHECK_STEP_S
        speed = _speed(part, self.rig_speed, 1.0 + share)
        return _path(part, self.road, speed, shift_m, int(self.times[0]), duration_s)


def _place(
    parts: Sequence[AlongPart | AcrossPart], sizes: Sequence[FloatArray], jitter: FloatArray,
    way: _Way, rig: Outline,
) -> tuple[dict[int, PoseSpline], list[int]]:  # fmt: skip
    """Paths by the parts' numbers, and the parts that found none; `jitter` is (M, draws, 2)."""
    bodies: list[Outline] = [rig]
    placed: dict[int, PoseSpline] = {}
    for members in _groups(parts):
        for shift_m, share in jitter[members[0]]:
            paths = {i: way.path(parts[i], float(shift_m), float(share)) for i in members}
            found = [Outline.along(path, way.times, sizes[i]) for i, path in paths.items()]
            if _is_free(found, bodies):
                bodies += found
                placed.update(paths)
                break
    return placed, [i for i in range(len(parts)) if i not in placed]


def _groups(parts: Sequence[AlongPart | AcrossPart]) -> list[list[int]]:
    """The parts' numbers by their group, in the order of the first of each."""
    groups: dict[str | int, list[int]] = {}
    for i, part in enumerate(parts):
        groups.setdefault(i if part.group is None else part.group, []).append(i)
    return list(groups.values())


def _is_free(group: Sequence[Outline], others: Sequence[Outline]) -> bool:
    """Whether a group keeps clear of all others, and its members out of each other."""
    return not any(
        touching(body, other, CLEARANCE_M).any() for body in group for other in others
    ) and not any(touching(a, b).any() for a, b in combinations(group, 2))


def _sizes(
    parts: Sequence[AlongPart | AcrossPart], share: float, rng: np.random.Generator
) -> list[FloatArray]:
    """Length, width and height (3,) of each part, changed by up to `share`."""
    factor = 1.0 + share * rng.uniform(-1.0, 1.0, (len(parts), 3))
    return [
        factor[i] * (SIZES[part.kind] if part.size is None else np.array(part.size))
        for i, part in enumerate(parts)
    ]


def _look(
    scene: SceneFile, part: AlongPart | AcrossPart, size: FloatArray, rng: np.random.Generator
) -> tuple[Box, ...]:
    mean = float(rng.uniform(*scene.light.paint)) if part.grey is None else part.grey
    look = paint(mean, scene.light, texture_seed(rng), texture_cell(part.kind))
    return body_boxes(part.kind, size, look)


def _speed(part: AlongPart | AcrossPart, rig_speed: SmoothSteps, factor: float) -> SmoothSteps:
    if part.speed is not None:
        speed = SmoothSteps.make(*part.speed)
    else:
        speed = SmoothSteps(rig_speed.knots - part.ahead_s, rig_speed.values)
    return SmoothSteps(speed.knots, factor * speed.values)


def _path(
    part: AlongPart | AcrossPart, road: Road, speed: SmoothSteps, shift_m: float, origin_ns: int,
    duration_s: float,
) -> PoseSpline:  # fmt: skip
    if isinstance(part, AlongPart):
        start_m = part.start_m + (-shift_m if part.oncoming else shift_m)
        return traffic_path(
            road, speed, origin_ns, duration_s,
            start_m=start_m, offset_m=part.offset_m, oncoming=part.oncoming,
        )  # fmt: skip
    xy, along = road.at(np.array(part.at_m), part.from_offset_m)
    yaw = float(along + np.radians(part.heading_deg))
    start = (float(xy[0] + shift_m * np.cos(yaw)), float(xy[1] + shift_m * np.sin(yaw)))
    return straight_path(start, yaw, speed, origin_ns, duration_s)


def _collision(
    scene: SceneFile, sizes: Sequence[FloatArray], blocked: int, way: _Way, rig: Outline,
    placed: Mapping[int, PoseSpline],
) -> str:  # fmt: skip
    parts: list[AlongPart | AcrossPart] = [*scene.along, *scene.across]
    names = [f"along.{i}" for i in range(len(scene.along))]
    names += [f"across.{i}" for i in range(len(scene.across))]

    def outline(i: int, path: PoseSpline) -> Outline:
        return Outline.along(path, way.times, sizes[i])

    bodies = {"the rig": rig, **{names[i]: outline(i, path) for i, path in placed.items()}}
    group = next(members for members in _groups(parts) if blocked in members)
    for i in group:
        body = outline(i, way.path(parts[i], 0.0, 0.0))
        for name, other in bodies.items():
            gap_m = 0.0 if name in [names[k] for k in group] else CLEARANCE_M
            hit = touching(body, other, gap_m)
            if hit.any():
                seconds = 1e-9 * float(way.times[int(np.argmax(hit))] - way.times[0])
                where = f"{names[i]} touches {name} at {seconds:.1f} s"
                return f"scene: {where}; change its start or speed"
        bodies[names[i]] = body
    raise AssertionError("a body that is blocked touches another")


def carrier_outline(
    path: PoseSpline, T_vehicle_imu: FloatArray, times: IntArray, size: FloatArray
) -> Outline:
    """The outline of a rig's carrier (length, width, ...), whose frame is the vehicle's."""
    T = path.pose(times) @ se3.inverse(T_vehicle_imu)
    return Outline(T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0]), float(size[0]), float(size[1]))
