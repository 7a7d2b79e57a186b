"""The compiled parts of the search for new corners: where there is room, and which are taken.

The plain twins are in `tests/frontend/test_corner_kernel.py`.
"""

from pathlib import Path

import numpy as np

from ovmot.frontend.spread_kernel import spread_corners
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled, part


@part
def _is_set(image: Image, u: float, v: float) -> bool:
    """Is the image not zero at a pixel? Not beyond its border, nor at NaN."""
    column, row = np.rint(u), np.rint(v)
    inside = 0.0 <= column < image.shape[1] and 0.0 <= row < image.shape[0]
    return bool(inside and image[int(row), int(column)] > 0)


@part
def _open_cells(room: Image, existing: FloatArray, side: int, per_cell: int) -> None:
    """Set `room` (height, width) in the cells of this side with fewer than `per_cell` features."""
    height, width = room.shape
    rows, columns = -(-height // side), -(-width // side)
    held = np.zeros((rows, columns), dtype=np.int64)
    for u, v in existing:
        if 0.0 <= u < columns * side and 0.0 <= v < rows * side:
            held[int(v) // side, int(u) // side] += 1
    for i in range(rows):
        for j in range(columns):
            if held[i, j] < per_cell:
                room[i * side : (i + 1) * side, j * side : (j + 1) * side] = 255


def find_room(
    height: int, width: int, mask: Image, focus: Image, existing: FloatArray, dynamic: BoolArray,
    most: IntArray, cell_px: IntArray, per_cell: IntArray,
) -> tuple[Image, IntArray]:  # fmt: skip
    """Where corners are sought, an image (height, width), 255 there; how many are wanted (3,).

    Spread evenly, one for each fine cell, and in the focus: of each kind `most` (3,), less the
    `existing` features (N, 2); all but the `dynamic` ones (N,) outside the focus count as evenly
    spread, and what there is of these too many as of the second kind. `cell_px`, `per_cell` (2,):
    of the first two kinds, whose full cells have no room. None where `mask` is not zero; this
    and `focus` are of the image's size, or empty.
    """
    room, wanted = np.zeros((height, width), dtype=np.uint8), most.copy()
    for n in range(len(existing)):
        if _is_set(focus, existing[n, 0], existing[n, 1]):
            wanted[2] -= 1
        elif not dynamic[n]:
            wanted[0] -= 1
    wanted[1] += min(wanted[0], 0)
    for k in range(2):
        if wanted[k] > 0:
            _open_cells(room, existing, cell_px[k], per_cell[k])
    for v in range(height):
        if wanted[2] > 0 and len(focus):
            for u in range(width):
                room[v, u] |= focus[v, u]
        if len(mask):
            for u in range(width):
                if mask[v, u] != 0:
                    room[v, u] = 0
    return room, wanted


def take_corners(
    corners: FloatArray, existing: FloatArray, focus: Image, wanted: IntArray,
    distance_px: FloatArray, cell_px: IntArray, per_cell: IntArray, width: int, height: int,
) -> FloatArray:  # fmt: skip
    """Corners (K, 2), of those given (M, 2), the strongest first, by three spreads in turn.

    Each spread keeps its own distance, cell and number in a cell, from the `existing` features
    (N, 2) and from what was taken before; the third one takes what is in the focus, the others
    the rest. See `find_room` and `spread_kernel.spread_corners`.
    """
    in_focus, taken = np.zeros(len(corners), dtype=np.bool_), existing
    for m in range(len(corners)):
        in_focus[m] = _is_set(focus, corners[m, 0], corners[m, 1])
    inside, outside = corners[in_focus], corners[~in_focus]
    for k in range(3):
        among = inside if k == 2 else outside
        if wanted[k] > 0 and len(among):
            chosen = spread_corners(
                among, taken, wanted[k], distance_px[k], cell_px[k], per_cell[k], width, height
            )
            taken = np.concatenate((taken, among[chosen]))
    return taken[len(existing) :]


_folder = code_folder(Path(__file__))
find_room_compiled = compiled(find_room, _folder)
take_corners_compiled = compiled(take_corners, _folder)
