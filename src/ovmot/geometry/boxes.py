"""Boxes that stand upright: their corners."""

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray

UNIT_CORNERS = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
)  # fmt: skip
"""Corners (8, 3) of a cube of side 1 about the origin; bits of a row's index are x, y, z."""


def box_corners(centre: FloatArray, size: FloatArray, yaw: float) -> FloatArray:
    """Corners (8, 3), in the order of `UNIT_CORNERS`, of a box with this centre (3,), length, width
    and height (3,), turned about z by `yaw` (rad)."""
    return centre + (UNIT_CORNERS * size) @ so3.rotation_z(yaw).T
