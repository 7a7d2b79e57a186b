"""A street as data: textured boxes that stand, rigid movers made of boxes, ground and sky.

World frame: z up, the ground is the plane z = 0. A mover's frame: x ahead, y left, z up, origin on
the ground below its middle.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline


@dataclass(frozen=True, slots=True)
class Texture:
    """Procedural grey: octaves of hashed value noise on a square lattice.

    `mean` and `contrast` in grey levels (the coarsest octave reaches ±contrast); `cell_m` is the
    coarsest lattice, each next octave is half as large; `softness` from 0, cells with sharp edges,
    to 1, linear slopes.
    """

    mean: float
    contrast: float
    cell_m: float
    seed: int
    softness: float = 0.0
    octaves: int = 6


@dataclass(frozen=True, slots=True)
class Box:
    """An oriented box: `T_body_box` (4, 4) to its middle, full side lengths `size` (3,) in m.

    The body of a box that stands is the world.
    """

    T_body_box: FloatArray
    size: FloatArray
    texture: Texture


@dataclass(frozen=True, slots=True)
class ObjectState:
    """Truth of one mover at one time: its whole box's centre (3,), yaw, size and velocity."""

    object_id: int
    category: str
    center: FloatArray
    yaw: float
    size: FloatArray
    velocity: FloatArray
    yaw_rate: float


@dataclass(frozen=True, slots=True)
class Mover:
    """A rigid body on a path. `object_id` is 1..255, its value in the object-id image.

    `size` (3,) is the length, width and height of the box around all its `boxes`.
    """

    object_id: int
    category: str
    size: FloatArray
    boxes: tuple[Box, ...]
    path: PoseSpline

    def state(self, timestamp_ns: int) -> ObjectState:
        """Where it is and how it moves; raises `ValueError` outside its path."""
        T_world_body = self.path.pose(timestamp_ns)
        return ObjectState(
            self.object_id,
            self.category,
            se3.apply(T_world_body, np.array([0.0, 0.0, 0.5 * self.size[2]])),
            float(np.arctan2(T_world_body[1, 0], T_world_body[0, 0])),
            self.size,
            self.path.velocity(timestamp_ns),
            float(self.path.angular_velocity(timestamp_ns)[2]),
        )


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that a camera can see; `sun` (3,) points to the light."""

    boxes: tuple[Box, ...]
    movers: tuple[Mover, ...]
    ground: Texture
    sky: Texture
    sun: FloatArray

    def placed_boxes(self, timestamp_ns: int) -> tuple[list[Box], list[int]]:
        """All boxes with poses in the world at one time, and each one's object id (0: stands)."""
        placed, ids = list(self.boxes), [0] * len(self.boxes)
        for mover in self.movers:
            T_world_body = mover.path.pose(timestamp_ns)
            for box in mover.boxes:
                placed.append(Box(T_world_body @ box.T_body_box, box.size, box.texture))
                ids.append(mover.object_id)
        return placed, ids


def box_at(
    center: tuple[float, float, float],
    size: tuple[float, float, float],
    texture: Texture,
    yaw: float = 0.0,
) -> Box:
    """A box turned about the vertical, by its middle and full side lengths in metres."""
    R = so3.exp(np.array([0.0, 0.0, yaw]))
    return Box(se3.make(R, np.array(center)), np.array(size), texture)


def car_boxes(size: FloatArray, texture: Texture) -> tuple[Box, ...]:
    """Body, cabin and bonnet lines of a car of given length, width, height, in its own frame."""
    length, width, height = (float(x) for x in size)
    glass = Texture(0.6 * texture.mean, texture.contrast, texture.cell_m, texture.seed + 1)
    floor, waist = 0.12 * height, 0.6 * height
    body = box_at((0.0, 0.0, 0.5 * (floor + waist)), (length, width, waist - floor), texture)
    cabin = box_at(
        (-0.06 * length, 0.0, 0.5 * (waist + height)),
        (0.56 * length, 0.88 * width, height - waist),
        glass,
    )
    return body, cabin


def walker_boxes(size: FloatArray, texture: Texture) -> tuple[Box, ...]:
    """Legs, trunk and head of a person of given depth, width, height, in the person's frame."""
    depth, width, height = (float(x) for x in size)
    legs = Texture(0.5 * texture.mean, texture.contrast, texture.cell_m, texture.seed + 1)
    return (
        box_at((0.0, 0.0, 0.24 * height), (0.6 * depth, 0.7 * width, 0.48 * height), legs),
        box_at((0.0, 0.0, 0.66 * height), (depth, width, 0.36 * height), texture),
        box_at((0.0, 0.0, 0.92 * height), (0.2, 0.18, 0.16 * height), texture),
    )
