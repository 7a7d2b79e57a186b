"""Closed-form registration of matched points, batched over leading axes."""

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


def register_rigid(source: FloatArray, target: FloatArray) -> FloatArray:
    """Motions T (..., 4, 4) with target ~ T source for points (..., N, 3), least squares.

    W. Kabsch 1976 with S. Umeyama's sign (1991): R is the rotation nearest to the correlation of
    the centred points. Three points that do not lie on a line fix the motion.
    """
    centre_source, centre_target = source.mean(-2), target.mean(-2)
    a = source - centre_source[..., None, :]
    b = target - centre_target[..., None, :]
    R = so3.project_to_rotation(np.swapaxes(b, -1, -2) @ a)
    return se3.make(R, centre_target - (R @ centre_source[..., None])[..., 0])


def triangle_height(points: FloatArray) -> FloatArray:
    """Smallest height (...,) of triangles (..., 3, 3): zero where the corners lie on a line."""
    sides = points[..., [1, 2, 0], :] - points
    squared = (sides * sides).sum(-1)
    along = (sides[..., 0, :] * sides[..., 1, :]).sum(-1)
    area = np.sqrt(np.maximum(squared[..., 0] * squared[..., 1] - along**2, 0.0))
    longest = np.sqrt(squared.max(-1))
    height: FloatArray = area / np.maximum(longest, 1e-12)
    return height
