"""The compiled search for features in an image: by their first patch, else by optical flow.

Both functions hold no Python lock, and take each feature by itself.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ovmot.frontend.epipolar_kernel import is_free
from ovmot.frontend.klt_kernel import LANES, MAX_ROUND_TRIP_PX, flow_there_and_back
from ovmot.frontend.patch_kernel import (
    MARGIN,
    PADDED,
    SIDE,
    Patch,
    Quads,
    Room,
    align_patch,
    cut_patch,
    make_room,
)
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part, part

LOST, TRACKED, ALIGNED = 0, 1, 2
"""How a feature was found: not at all, by optical flow alone, by its first patch."""

_Float32 = npt.NDArray[np.float32]
_States = npt.NDArray[np.uint8]


@inlined_part
def _patch_at(patches: Patch, slot: int) -> Patch:
    """One of many patches."""
    return Patch(patches.grey[slot], patches.slope[slot], patches.gain[slot], patches.inverse[slot])


@inlined_part
def _find_one(
    source: tuple[Image, ...], target: tuple[Image, ...], words: Quads, side: int,
    patch: Patch, points: FloatArray, n_levels: int,
    min_correlation: float, sure_correlation: float, max_steps: int, small_step_px: float,
    room: _Float32, patch_room: Room, uv: FloatArray, warp: FloatArray,
) -> int:  # fmt: skip
    """Move `uv` (2,) and `warp` (2, 2), in place, to where a feature is; its state.

    `points` (2,): where it is in the source. See `find_features`.
    """
    height, width = words.shape[0] - 2 * MARGIN, words.shape[1] - 2 * MARGIN
    u0, v0, begin_u, begin_v = points[0], points[1], uv[0], uv[1]
    w00, w01, w10, w11 = warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1]
    if not (0.0 <= begin_u < width and 0.0 <= begin_v < height):
        return LOST
    # by the patch alone, where that is sure
    correlation = align_patch(words, patch, uv, warp, patch_room, max_steps, small_step_px)
    if correlation > sure_correlation:
        return ALIGNED
    # by the patch, where flow from there stays there
    if correlation > min_correlation:
        u, v, ok = flow_there_and_back(source, target, 1, side, room, u0, v0, uv[0], uv[1])
        if ok and math.hypot(u - uv[0], v - uv[1]) < MAX_ROUND_TRIP_PX:
            return ALIGNED
    # by flow, and by the patch from where that leads
    u, v, ok = begin_u, begin_v, n_levels > 0
    if ok:
        u, v, ok = flow_there_and_back(source, target, n_levels, side, room, u0, v0, u, v)
    uv[0], uv[1] = u, v
    warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1] = w00, w01, w10, w11
    if not ok:
        return LOST
    correlation = align_patch(words, patch, uv, warp, patch_room, max_steps, small_step_px)
    if correlation > min_correlation:
        return ALIGNED
    uv[0], uv[1] = u, v
    warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1] = w00, w01, w10, w11
    return TRACKED


def find_features(
    source: tuple[Image, ...], target: tuple[Image, ...], words: Quads, side: int,
    patches: Patch, slot: IntArray, start_warp: FloatArray,
    points: FloatArray, row: IntArray, starts: FloatArray, n_levels: IntArray, must_fit: bool,
    min_correlation: float, sure_correlation: float, max_steps: int, small_step_px: float,
    uv: FloatArray, warp: FloatArray, state: _States,
) -> None:  # fmt: skip
    """Find the features `row` (M,) of N in another image: fill pixels `uv` (N, 2), `warp`
    (N, 2, 2), `state` (N,).

    First the patch is aligned from the start, the predicted place: that is the answer beyond
    `sure_correlation`, and beyond `min_correlation` where optical flow agrees. Else flow leads from
    the start to where it is aligned again; where it does not fit, the flow's answer stays, with the
    warp it started from. Nothing is sought outside the image.

    `starts` (H, N, 2) are tried in order until one is `ALIGNED`, or `TRACKED` if not `must_fit`;
    those that are NaN are left out, and nothing is filled where none succeeds. `n_levels` (H, N) of
    the pyramids are searched; with none, the patch alone is.

    `source`, `target`: pyramids of `klt_kernel`, for windows of `side` pixels, of the image that
    holds `points` (N, 2) and of the one searched; `words`: the latter by
    `preprocessing.patch_image`. `patches`, with their `start_warp` (S, 2, 2): arrays of S patches;
    of feature n that at `slot[n]`.
    """
    room = np.zeros((5, (side + 4) ** 2 + LANES), dtype=np.float32)
    patch_room = make_room()
    at_uv, at_warp = np.empty(2), np.empty((2, 2))
    for n in row:
        at = slot[n]
        for h in range(len(starts)):
            if not (math.isfinite(starts[h, n, 0]) and math.isfinite(starts[h, n, 1])):
                continue
            at_uv[0], at_uv[1] = starts[h, n, 0], starts[h, n, 1]
            at_warp[0, 0], at_warp[0, 1] = start_warp[at, 0, 0], start_warp[at, 0, 1]
            at_warp[1, 0], at_warp[1, 1] = start_warp[at, 1, 0], start_warp[at, 1, 1]
            how = _find_one(
                source, target, words, side, _patch_at(patches, at), points[n], n_levels[h, n],
                min_correlation, sure_correlation, max_steps, small_step_px,
                room, patch_room, at_uv, at_warp,
            )  # fmt: skip
            if how == ALIGNED or (how == TRACKED and not must_fit):
                uv[n, 0], uv[n, 1], state[n] = at_uv[0], at_uv[1], how
                warp[n, 0, 0], warp[n, 0, 1] = at_warp[0, 0], at_warp[0, 1]
                warp[n, 1, 0], warp[n, 1, 1] = at_warp[1, 0], at_warp[1, 1]
                break


def cut_patches(
    words: Quads, uv: FloatArray, slot: IntArray, patches: Patch, damping: float
) -> None:
    """Fill the patches at `slot` (N,) by those around pixels `uv` (N, 2) of an image.

    `patches`: arrays of S patches; see `cut_patch`.
    """
    wide = np.zeros((SIDE + 2, SIDE + 2), dtype=np.float32)
    rows = np.zeros((6, PADDED), dtype=np.float32)
    for n in range(len(uv)):
        patch = _patch_at(patches, slot[n])
        cut_patch(words, uv[n, 0], uv[n, 1], wide, rows, patch, damping)


@part
def _is_rescaled(warp: FloatArray, max_scale: float) -> bool:
    """Is a patch seen larger or smaller by more than `max_scale`? A singular value of the warp
    (2, 2) says so."""
    square = warp[0, 0] ** 2 + warp[0, 1] ** 2 + warp[1, 0] ** 2 + warp[1, 1] ** 2
    det = warp[0, 0] * warp[1, 1] - warp[0, 1] * warp[1, 0]
    root = math.sqrt(max(square * square - 4.0 * det * det, 0.0))
    largest, smallest = 0.5 * (square + root), 0.5 * (square - root)  # squared singular values
    return bool(largest > max_scale * max_scale or smallest * max_scale * max_scale < 1.0)


def keep_found(
    uv: FloatArray, xy: FloatArray, warp: FloatArray, found: BoolArray, fits: BoolArray,
    mask: Image, width: int, height: int, border_px: int, max_scale: float,
) -> tuple[IntArray, BoolArray]:  # fmt: skip
    """Which features (M,) of N go on, and of which the patch is stale (M,).

    Those that are `found` (N,) at pixels `uv` (N, 2) that are `is_free`, and within the camera
    model: normalized coordinates `xy` (N, 2) are known. A patch is stale that does not fit, `fits`
    (N,), or that its `warp` (N, 2, 2) shows larger or smaller by more than `max_scale`.
    """
    row, stale, count = np.empty(len(uv), np.int64), np.empty(len(uv), np.bool_), 0
    for n in range(len(uv)):
        free = is_free(uv[n, 0], uv[n, 1], mask, width, height, border_px)
        if not (found[n] and free and math.isfinite(xy[n, 0])):
            continue
        row[count] = n
        stale[count] = not fits[n] or _is_rescaled(warp[n], max_scale)
        count += 1
    return row[:count], stale[:count]


_folder = code_folder(Path(__file__))
keep_found_compiled = compiled(keep_found, _folder)
find_features_compiled = compiled(find_features, _folder)
cut_patches_compiled = compiled(cut_patches, _folder)
