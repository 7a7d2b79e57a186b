"""New corners: FAST where there is room, spread by a grid, denser where something may move."""

from dataclasses import dataclass

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.frontend.corner_kernel import find_room_compiled, take_corners_compiled
from ovmot.frontend.fast_kernel import fast_corners_compiled
from ovmot.frontend.preprocessing import NO_MASK, for_kernels
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.physics import MAX_VEHICLE_SIZE_M
from ovmot.settings import TrackerSettings
from ovmot.types import PointLabel, ScenePoints


@dataclass(frozen=True, slots=True)
class Spread:
    """How corners lie over an image: `distance_px` apart, `per_cell` at most in a square cell of
    side `cell_px`."""

    distance_px: float
    cell_px: int
    per_cell: int


def new_corners(
    image: Image,
    mask: Image | None,
    existing: FloatArray,
    dynamic: BoolArray,
    focus: Image | None,
    settings: TrackerSettings,
) -> FloatArray:
    """New corners (M, 2), pixels, beside the `existing` features (N, 2), of which some are dynamic.

    Over the image (height, width) evenly, up to `max_features` without the dynamic ones, of which
    the ego motion has nothing; one in each fine cell without any, up to `fine_features` more; and
    up to `focus_features` densely where `focus` (height, width) is not zero. None where `mask`
    (height, width) is not zero, or where the window of optical flow would not be in the image. All
    lengths follow from the fine cell, and so scale with the image.
    """
    height, width = image.shape
    cell_px = fine_cell_px(image.shape, settings)
    even = even_spread(settings.max_features, cell_px, image.shape)
    # what covers tracked features is tracked itself, though there are enough: one in a fine cell
    spreads = (
        even, Spread(even.distance_px, cell_px, 1), Spread(cell_px / 4.0, cell_px, 3 * 4)
    )  # fmt: skip
    most = settings.max_features, settings.fine_features, settings.focus_features
    cells = np.array([s.cell_px for s in spreads]), np.array([s.per_cell for s in spreads])
    wanted_there, unwanted = (NO_MASK if m is None else for_kernels(m) for m in (focus, mask))
    room, wanted = find_room_compiled(
        height, width, unwanted, wanted_there, existing, dynamic, np.array(most), *cells,
    )  # fmt: skip
    corners = fast_corners_compiled(
        for_kernels(image), room, settings.fast_threshold, settings.klt_window_px // 2
    )
    apart_px = np.array([s.distance_px for s in spreads])
    taken: FloatArray = take_corners_compiled(
        corners, existing, wanted_there, wanted, apart_px, *cells, width, height
    )
    return taken


def fine_cell_px(shape: tuple[int, ...], settings: TrackerSettings) -> int:
    """Side of a fine cell in an image of this shape (height, width): 20 px of 640."""
    return -(-shape[1] // settings.fine_columns)


def even_spread(n_most: int, fine_cell_px: int, shape: tuple[int, ...]) -> Spread:
    """Corners 0.6 fine cells apart, in cells three times as wide as the fine ones.

    Each cell holds twice its share of `n_most` corners: sky and road leave half of them empty.
    """
    height, width = shape[:2]
    cell_px = 3 * fine_cell_px
    cells = -(-width // cell_px) * -(-height // cell_px)
    return Spread(0.6 * fine_cell_px, cell_px, -(-2 * n_most // cells))


def focus_areas(
    points: ScenePoints, outlier: BoolArray, places: FloatArray, camera: Camera
) -> tuple[FloatArray, FloatArray]:
    """Where more features are wanted: left pixels (M, 2) and radii (M,) in pixels around them.

    They are those of points that move or do not look static: dynamic ones, those of objects, and
    the `outlier` ones (N,); and places (K, 3) in the camera's frame where bodies may come into
    sight. A radius is half of a vehicle's greatest width at the point's depth:
    the parts of the same body that are not seen yet lie that near. Its length, which it shows from
    the side alone, would reach beyond its ends to the street.
    """
    depth = points.p_cam0[:, 2]
    moving = (points.label == int(PointLabel.DYNAMIC)) | (points.track_id >= 0)
    chosen = np.flatnonzero((moving | outlier) & np.isfinite(depth))
    ahead = places[places[:, 2] > 1.0]
    uv = np.concatenate([points.pixels[chosen, :2], camera.project(ahead)])
    inside = camera.inside(uv)
    depth = np.concatenate([depth[chosen], ahead[:, 2]])[inside]
    radius = 0.5 * MAX_VEHICLE_SIZE_M[1] * camera.fx / np.maximum(depth, 1.0)
    return uv[inside], radius


def focus_mask(
    shape: tuple[int, ...], uv: FloatArray, radius_px: FloatArray, cell_px: int
) -> Image | None:
    """An image (height, width), 255 within the radii (N,) of pixels (N, 2); None without any.

    Radii are at least 0.4 of a fine cell, of side `cell_px`. Those beyond three cells, the cell
    of the even spread, are left out: what is near has its features by the ordinary density.
    """
    small = radius_px < 3 * cell_px
    if not small.any():
        return None
    mask = np.zeros(shape[:2], dtype=np.uint8)
    centers = uv[small].round().astype(int).tolist()
    radii = np.maximum(radius_px[small], 0.4 * cell_px).round().astype(int).tolist()
    for (u, v), radius in zip(centers, radii, strict=True):
        cv2.circle(mask, (u, v), radius, 255, cv2.FILLED)
    return mask
