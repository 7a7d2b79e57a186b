"""What moves on a street: the size of each kind, and the boxes that it is drawn with.

A body's frame: x ahead, y left, z up, origin on the ground below the middle of the box around it.
"""

from collections.abc import Callable

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.sim.scene import Box, Texture, box_at, car_boxes, walker_boxes

CAR_SIZE = np.array([4.4, 1.8, 1.45])
SIZES = {
    "car": CAR_SIZE,
    "van": np.array([5.2, 2.0, 2.3]),
    "truck": np.array([8.0, 2.45, 3.3]),
    "bus": np.array([12.0, 2.55, 3.1]),
    "car_trailer": np.array([7.9, 1.8, 1.45]),
    "walker": np.array([0.4, 0.6, 1.75]),
    "cyclist": np.array([1.75, 0.55, 1.75]),
}
"""Length, width and height, m."""
CATEGORIES = {
    "car": "car", "van": "van", "truck": "truck", "bus": "bus", "car_trailer": "car",
    "walker": "pedestrian", "cyclist": "cyclist",
}  # fmt: skip
"""What the truth calls each kind."""
_CELLS_M = {"walker": 0.3, "cyclist": 0.3}


def texture_cell(kind: str) -> float:
    """Width in m of the coarsest cells of its paint."""
    return _CELLS_M.get(kind, 0.7)


def body_boxes(kind: str, size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """The boxes of a body of a kind (a key of `SIZES`), of given length, width and height (3,)."""
    shapes: dict[str, Callable[[FloatArray, Texture], tuple[Box, ...]]] = {
        "car": car_boxes, "van": _van_boxes, "truck": _truck_boxes, "bus": _bus_boxes,
        "car_trailer": _car_and_trailer_boxes, "walker": walker_boxes, "cyclist": _cyclist_boxes,
    }  # fmt: skip
    return shapes[kind](size, look)


def _van_boxes(size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """A tall body behind a low bonnet."""
    length, width, height = (float(x) for x in size)
    floor, waist, bonnet = 0.1 * height, 0.55 * height, 0.18 * length
    dark = Texture(0.7 * look.mean, look.contrast, look.cell_m, look.seed + 1)
    return (
        box_at(
            (-0.5 * bonnet, 0.0, 0.5 * (floor + height)),
            (length - bonnet, width, height - floor), look,
        ),
        box_at(
            (0.5 * (length - bonnet), 0.0, 0.5 * (floor + waist)),
            (bonnet, 0.96 * width, waist - floor), dark,
        ),
    )  # fmt: skip


def _truck_boxes(size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """A cargo box above a frame, and a cab before it."""
    length, width, height = (float(x) for x in size)
    cab, gap, deck = 0.24 * length, 0.03 * length, 0.3 * height
    dark = Texture(0.5 * look.mean, look.contrast, look.cell_m, look.seed + 1)
    paint_cab = Texture(0.8 * look.mean, look.contrast, look.cell_m, look.seed + 2)
    cargo = length - cab - gap
    return (
        box_at(
            (-0.5 * (length - cargo), 0.0, 0.5 * (deck + height)), (cargo, width, height - deck),
            look,
        ),
        box_at((-0.5 * cab, 0.0, 0.65 * deck), (length - cab, 0.8 * width, 0.7 * deck), dark),
        box_at(
            (0.5 * (length - cab), 0.0, 0.45 * height), (cab, 0.95 * width, 0.72 * height),
            paint_cab,
        ),
    )  # fmt: skip


def _bus_boxes(size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """Panels, a band of windows all around, and a roof."""
    length, width, height = (float(x) for x in size)
    floor, sill, top = 0.1 * height, 0.42 * height, 0.82 * height
    glass = Texture(0.5 * look.mean, look.contrast, look.cell_m, look.seed + 1)
    return (
        box_at((0.0, 0.0, 0.5 * (floor + sill)), (length, width, sill - floor), look),
        box_at((0.0, 0.0, 0.5 * (sill + top)), (0.99 * length, 0.97 * width, top - sill), glass),
        box_at((0.0, 0.0, 0.5 * (top + height)), (length, width, height - top), look),
    )


def _car_and_trailer_boxes(size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """A car, a bar as thick as an arm, and a box on it: rigid, as they are on a straight road."""
    length, width, height = (float(x) for x in size)
    car, bar = 0.56 * length, 0.14 * length
    box = length - car - bar
    grey = Texture(0.7 * look.mean, look.contrast, look.cell_m, look.seed + 2)
    ahead = 0.5 * (length - car)
    moved = tuple(
        box_at((part.T_body_box[0, 3] + ahead, 0.0, part.T_body_box[2, 3]), tuple(part.size),
               part.texture)
        for part in car_boxes(np.array([car, width, height]), look)
    )  # fmt: skip
    between = 0.5 * length - car - 0.5 * bar
    return (
        *moved,
        box_at((between, 0.0, 0.3 * height), (bar, 0.1, 0.1), grey),
        box_at((-0.5 * (length - box), 0.0, 0.55 * height), (box, 0.9 * width, 0.7 * height), grey),
    )


def _cyclist_boxes(size: FloatArray, look: Texture) -> tuple[Box, ...]:
    """Two wheels, a frame, legs, a trunk and a head."""
    length, width, height = (float(x) for x in size)
    wheel = 0.38 * length
    dark = Texture(0.4 * look.mean, look.contrast, look.cell_m, look.seed + 1)
    end = 0.5 * (length - wheel)
    return (
        box_at((end, 0.0, 0.5 * wheel), (wheel, 0.06, wheel), dark),
        box_at((-end, 0.0, 0.5 * wheel), (wheel, 0.06, wheel), dark),
        box_at((0.0, 0.0, 0.3 * height), (0.5 * length, 0.06, 0.2 * height), dark),
        box_at((0.0, 0.0, 0.4 * height), (0.22 * length, 0.6 * width, 0.32 * height), dark),
        box_at((0.05 * length, 0.0, 0.71 * height), (0.25 * length, width, 0.32 * height), look),
        box_at((0.1 * length, 0.0, 0.935 * height), (0.2, 0.17, 0.13 * height), look),
    )
