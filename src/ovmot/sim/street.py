"""What stands along a road: houses wall to wall, parked cars, poles; and the greys of all things.

Whatever is drawn at random depends on the generator alone, not on how far the street reaches, so
that a longer simulation begins as a shorter one does.
"""

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.profiles import Road
from ovmot.sim.scene import Box, Texture, box_at, car_boxes
from ovmot.sim.scene_file import LightPart, StreetPart
from ovmot.sim.shapes import CAR_SIZE

_BEHIND_KERB_M = 1.8
_SIDES = (-1.0, 1.0)


def furnish(
    road: Road, street: StreetPart, light: LightPart, reach_m: float, rng: np.random.Generator
) -> tuple[Box, ...]:
    """All boxes that stand, from behind the road's start to `reach_m` along it."""
    boxes: list[Box] = []
    for side, side_rng in zip(_SIDES, rng.spawn(2), strict=True):
        houses, cars, poles = side_rng.spawn(3)
        if street.facades:
            boxes += _facades(road, side, street, light, reach_m, houses)
        if street.parked_every_m is not None:
            places = np.arange(14.0, reach_m, street.parked_every_m)
            places += cars.uniform(-4.0, 4.0)
            places = places[~_open(street, places, 0.5 * CAR_SIZE[0])]
            boxes += _parked_cars(road, places, side * street.kerb_m, light, cars)
        if street.poles_every_m is not None:
            places = np.arange(8.0, reach_m, street.poles_every_m) + poles.uniform(-5.0, 5.0)
            places = places[~_open(street, places, 0.1)]
            boxes += _poles(road, places, side * (street.kerb_m + _BEHIND_KERB_M), light, poles)
    return tuple(boxes)


def paint(mean: float, light: LightPart, seed: int, cell_m: float = 0.7) -> Texture:
    """A mover's or a car's surface."""
    return Texture(mean, 42.0 * light.contrast, cell_m, seed)


def ground(light: LightPart, rng: np.random.Generator) -> Texture:
    """The plane z = 0."""
    return Texture(light.ground, 22.0 * light.contrast, 3.0, texture_seed(rng), softness=0.15)


def sky(light: LightPart, rng: np.random.Generator) -> Texture:
    """Soft clouds."""
    seed = texture_seed(rng)
    return Texture(light.sky, 10.0 * light.contrast, 1.0, seed, softness=1.0, octaves=3)


def texture_seed(rng: np.random.Generator) -> int:
    """A seed of a texture's lattice."""
    return int(rng.integers(1 << 30))


def away_from(
    boxes: tuple[Box, ...], path: PoseSpline, distance_m: float, step_s: float = 0.1
) -> tuple[Box, ...]:
    """Those boxes that the path, sampled every `step_s`, nowhere comes nearer than this."""
    if not boxes:
        return ()
    times = np.arange(path.start_ns, path.end_ns, round(1e9 * step_s), dtype=np.int64)
    points = path.pose(times)[:, :3, 3]
    kept = []
    for box in boxes:
        inside = np.abs(se3.apply(se3.inverse(box.T_body_box), points)) - 0.5 * box.size
        if np.linalg.norm(np.maximum(inside, 0.0), axis=-1).min() >= distance_m:
            kept.append(box)
    return tuple(kept)


def _open(street: StreetPart, places: FloatArray, half_m: float) -> BoolArray:
    """Whether (N,) what stands at these places, `half_m` to both sides, is in a crossing."""
    if street.crossing is None:
        return np.zeros(np.shape(places), dtype=bool)
    start, end = street.crossing
    return np.asarray((places + half_m > start) & (places - half_m < end))


def _facades(
    road: Road, side: float, street: StreetPart, light: LightPart, reach_m: float,
    rng: np.random.Generator,
) -> list[Box]:  # fmt: skip
    """Houses, each of its own depth, height and grey."""
    boxes = []
    arc = -15.0
    while arc < reach_m + 40.0:
        width, height, back = rng.uniform(7.0, 13.0), rng.uniform(6.0, 14.0), rng.uniform(0, 2)
        middle = arc + 0.5 * width
        x, y, yaw = _place(road, middle, side * (street.facade_m + back + 4.0))
        texture = Texture(rng.uniform(*light.faces), 38.0 * light.contrast, 2.4, texture_seed(rng))
        if not _open(street, np.array(middle), 0.5 * width):
            boxes.append(box_at((x, y, 0.5 * height), (width, 8.0, height), texture, yaw))
        arc += width + rng.uniform(0.0, 1.5)
    return boxes


def _parked_cars(
    road: Road, places: FloatArray, offset_m: float, light: LightPart, rng: np.random.Generator
) -> list[Box]:
    boxes: list[Box] = []
    for arc in places:
        x, y, yaw = _place(road, float(arc), offset_m)
        look = paint(rng.uniform(*light.paint), light, texture_seed(rng))
        T_world_car = box_at((x, y, 0.0), (1.0, 1.0, 1.0), look, yaw).T_body_box
        boxes += [
            Box(T_world_car @ part.T_body_box, part.size, part.texture)
            for part in car_boxes(CAR_SIZE, look)
        ]
    return boxes


def _poles(
    road: Road, places: FloatArray, offset_m: float, light: LightPart, rng: np.random.Generator
) -> list[Box]:
    boxes = []
    for arc in places:
        x, y, yaw = _place(road, float(arc), offset_m)
        look = Texture(
            0.8 * rng.uniform(*light.paint), 30.0 * light.contrast, 0.5, texture_seed(rng)
        )
        boxes.append(box_at((x, y, 2.5), (0.18, 0.18, 5.0), look, yaw))
    return boxes


def _place(road: Road, arc: float, offset: float) -> tuple[float, float, float]:
    xy, yaw = road.at(np.array(arc), offset)
    return float(xy[0]), float(xy[1]), float(yaw)
