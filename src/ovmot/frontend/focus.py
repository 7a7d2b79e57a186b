"""Where something seems to move, more features are wanted than elsewhere."""

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.types import PointLabel, ScenePoints

_LEAST_RADIUS_PX = 8.0
_NEAR_RADIUS_PX = 64.0  # a body as large as this has features enough


def focus_areas(
    points: ScenePoints, outlier: BoolArray, camera: Camera, width_m: float
) -> tuple[FloatArray, FloatArray]:
    """Left pixels (M, 2) of points that move or do not look static, and radii (M,) around them.

    `outlier` (N,) of the points; a radius is half of `width_m` at the point's depth.
    """
    depth = points.p_cam0[:, 2]
    moving = (points.label == int(PointLabel.DYNAMIC)) | (points.track_id >= 0)
    chosen = np.flatnonzero((moving | outlier) & np.isfinite(depth))
    radius = 0.5 * width_m * camera.fx / np.maximum(depth[chosen], 1.0)
    return points.pixels[chosen, :2], radius


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
