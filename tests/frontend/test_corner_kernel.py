"""Room for corners, and those that are taken, against plain NumPy twins."""

import numpy as np
import pytest

from ovmot.frontend.corner_kernel import find_room_compiled, take_corners_compiled
from ovmot.frontend.preprocessing import inside_mask
from ovmot.frontend.spread_kernel import spread_corners
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray

SHAPE = (100, 160)
CELL_PX, PER_CELL, APART_PX = (
    np.array([30, 10, 10]),
    np.array([3, 1, 12]),
    np.array([6.0, 6.0, 2.5]),
)


def features(n: int) -> FloatArray:
    """Some of them beyond the border, and one unknown."""
    uv = np.random.default_rng(n).uniform(-5.0, 170.0, (n, 2))
    uv[:1] = np.nan
    return uv


def focus_of(there: bool) -> Image:
    focus = np.zeros(SHAPE if there else (0, 0), dtype=np.uint8)
    focus[20:60, 30:90] = 255
    return focus


def room_numpy(
    mask: Image, focus: Image, existing: FloatArray, dynamic: BoolArray, most: IntArray
) -> tuple[Image, IntArray]:
    dense = inside_mask(existing, focus if focus.size else None)
    n_even = most[0] - int((~dense & ~dynamic).sum())
    wanted = np.array([n_even, most[1] + min(n_even, 0), most[2] - int(dense.sum())])
    room = np.zeros(SHAPE, dtype=np.uint8)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for side, per_cell, n in zip(CELL_PX[:2], PER_CELL[:2], wanted[:2], strict=True):
        cells = existing // side
        held = [
            [int((cells == (j, i)).all(axis=1).sum()) for j in range(-(-SHAPE[1] // side))]
            for i in range(-(-SHAPE[0] // side))
        ]
        if n > 0:
            room[np.array(held)[v // side, u // side] < per_cell] = 255
    if wanted[2] > 0 and focus.size:
        room |= focus
    room[mask != 0] = 0
    return room, wanted


@pytest.mark.parametrize("most", [(90, 40, 50), (20, 40, 5), (5, 4, 5)])
@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("n", [0, 70])
def test_room(most: tuple[int, int, int], there: bool, n: int) -> None:
    mask, focus, existing = np.zeros(SHAPE, dtype=np.uint8), focus_of(there), features(n)
    mask[:, 120:] = 1
    dynamic = np.arange(n) % 3 == 0
    compiled = find_room_compiled(
        *SHAPE, mask, focus, existing, dynamic, np.array(most), CELL_PX, PER_CELL
    )
    room, wanted = room_numpy(mask, focus, existing, dynamic, np.array(most))
    np.testing.assert_array_equal(compiled[1], wanted)
    np.testing.assert_array_equal(compiled[0], room)
    nothing = np.zeros((0, 0), dtype=np.uint8)
    unmasked, _ = find_room_compiled(
        *SHAPE, nothing, focus, existing, dynamic, np.array(most), CELL_PX, PER_CELL
    )
    np.testing.assert_array_equal(unmasked[:, :120], room[:, :120])


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("wanted", [(30, 10, 20), (-4, 10, 0), (30, 0, 0)])
def test_taken(there: bool, wanted: tuple[int, int, int]) -> None:
    height, width = SHAPE
    focus, existing = focus_of(there), np.random.default_rng(3).uniform(8.0, 90.0, (20, 2))
    corners = np.round(np.random.default_rng(4).uniform([8, 8], [150, 90], (400, 2)))
    compiled = take_corners_compiled(
        corners, existing, focus, np.array(wanted), APART_PX, CELL_PX, PER_CELL, width, height
    )
    within, taken = inside_mask(corners, focus if focus.size else None), existing
    for k, n in enumerate(wanted):
        among = corners[within if k == 2 else ~within]
        chosen = spread_corners(
            among, taken, max(n, 0), APART_PX[k], CELL_PX[k], PER_CELL[k], width, height
        )
        taken = np.concatenate([taken, among[chosen]])
    np.testing.assert_array_equal(compiled, taken[len(existing) :])
