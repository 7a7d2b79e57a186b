"""Where something seems to move, more features are wanted than elsewhere."""

import cv2
import numpy as np

from ovmot.config import TrackerSettings
from ovmot.geometry.arrays import FloatArray, Image

_LEAST_RADIUS_PX = 8.0
_NEAR_RADIUS_PX = 64.0  # a body as large as this has features enough


def focus_mask(shape: tuple[int, ...], uv: FloatArray, radius_px: FloatArray) -> Image | None:
    """A picture (height, width), 255 within the radii (N,) of pixels (N, 2); None without any.

    Large ones are left out: what is near has its features by the ordinary density.
    """
    small = radius_px < _NEAR_RADIUS_PX
    if not small.any():
        return None
    mask = np.zeros(shape[:2], dtype=np.uint8)
    centers = uv[small].round().astype(int).tolist()
    radii = np.maximum(radius_px[small], _LEAST_RADIUS_PX).round().astype(int).tolist()
    for (u, v), radius in zip(centers, radii, strict=True):
        cv2.circle(mask, (u, v), radius, 255, cv2.FILLED)
    return mask


def dense_settings(settings: TrackerSettings) -> TrackerSettings:
    """Settings by which corners are chosen there: nearer to each other, any number a cell."""
    return settings.model_copy(
        update={"min_distance_px": settings.focus_distance_px, "max_features": 100_000}
    )


def sparse_settings(settings: TrackerSettings) -> TrackerSettings:
    """The settings by which every empty cell gets a corner, and no other one does.

    So a body that covers what was followed is followed itself, though there are enough elsewhere.
    """
    return settings.model_copy(update={"max_features": 1, "grid_cell_px": settings.covered_cell_px})
