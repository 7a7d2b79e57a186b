"""Where something seems to move, more features are wanted than elsewhere."""

import cv2
import numpy as np

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
