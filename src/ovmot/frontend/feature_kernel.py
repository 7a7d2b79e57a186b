"""The compiled search for features in an image: by their first patch, else by optical flow.

Both functions hold no Python lock, and take each feature by itself.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ovmot.frontend.klt_kernel import LANES, MAX_ROUND_TRIP_PX, flow_there_and_back
from ovmot.frontend.patch_kernel import MARGIN, SIDE, Quads, align_patch, cut_patch, make_room
from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.kernels.cache import code_folder, compiled

LOST, TRACKED, ALIGNED = 0, 1, 2
"""How a feature was found: not at all, by optical flow alone, by its first patch."""

_Float32 = npt.NDArray[np.float32]
_States = npt.NDArray[np.uint8]


def find_features(
    source: tuple[Image, ...], target: tuple[Image, ...], words: Quads, side: int,
    grey: _Float32, steepest: _Float32, inverse: _Float32, slot: IntArray,
    points: FloatArray, start: FloatArray, start_warp: FloatArray, n_levels: IntArray,
    min_correlation: float, sure_correlation: float, max_steps: int, small_step_px: float,
) -> tuple[FloatArray, FloatArray, _States]:  # fmt: skip
    """Where features are in another image: pixels (N, 2), warps (N, 2, 2), states (N,).

    First the patch is aligned from `start` (N, 2), the predicted place, and `start_warp`: that is
    the answer beyond `sure_correlation`, and beyond `min_correlation` where optical flow agrees.
    Else flow leads from `start` to where it is aligned again; where it does not fit, the flow's
    answer stays, with the warp it started from. Nothing is sought outside the image.

    `source`, `target`: pyramids of `klt_kernel`, for windows of `side` pixels, of the image that
    holds `points` (N, 2) and of the one searched; `words`: the latter by
    `preprocessing.patch_image`. `grey`
    (S, PADDED), `steepest` (S, 6, PADDED), `inverse` (S, 6, 6): patches, of feature n that at
    `slot[n]`. `n_levels` (N,) of the pyramids are searched; with none, the patch alone is.
    """
    n_points = len(points)
    uv, warp = start.copy(), start_warp.copy()
    state = np.zeros(n_points, dtype=np.uint8)
    room = np.zeros((5, (side + 4) ** 2 + LANES), dtype=np.float32)
    patch_room = make_room()
    height, width = words.shape[0] - 2 * MARGIN, words.shape[1] - 2 * MARGIN
    for n in range(n_points):
        if not (math.isfinite(start[n, 0]) and math.isfinite(start[n, 1])):
            uv[n, 0], uv[n, 1] = points[n, 0], points[n, 1]
        u0, v0, begin_u, begin_v = points[n, 0], points[n, 1], uv[n, 0], uv[n, 1]
        if not (0.0 <= begin_u < width and 0.0 <= begin_v < height):
            continue
        at = slot[n]
        # by the patch alone, where that is sure
        correlation = align_patch(
            words, grey[at], steepest[at], inverse[at], uv[n], warp[n], patch_room,
            max_steps, small_step_px,
        )  # fmt: skip
        if correlation > sure_correlation:
            state[n] = ALIGNED
            continue
        # by the patch, where flow from there stays there
        if correlation > min_correlation:
            u, v, ok = flow_there_and_back(
                source, target, 1, side, room, u0, v0, uv[n, 0], uv[n, 1]
            )
            if ok and math.hypot(u - uv[n, 0], v - uv[n, 1]) < MAX_ROUND_TRIP_PX:
                state[n] = ALIGNED
                continue
        if n_levels[n] == 0:
            continue
        # by flow, and by the patch from where that leads
        u, v, ok = flow_there_and_back(
            source, target, n_levels[n], side, room, u0, v0, begin_u, begin_v
        )
        uv[n, 0], uv[n, 1], warp[n] = u, v, start_warp[n]
        if not ok:
            continue
        correlation = align_patch(
            words, grey[at], steepest[at], inverse[at], uv[n], warp[n], patch_room,
            max_steps, small_step_px,
        )  # fmt: skip
        state[n] = ALIGNED
        if not correlation > min_correlation:
            uv[n, 0], uv[n, 1], warp[n], state[n] = u, v, start_warp[n], TRACKED
    return uv, warp, state


def cut_patches(
    words: Quads, uv: FloatArray, slot: IntArray,
    grey: _Float32, steepest: _Float32, inverse: _Float32, damping: float,
) -> None:  # fmt: skip
    """Fill the patches at `slot` (N,) by those around pixels `uv` (N, 2) of an image.

    `grey` (S, PADDED), `steepest` (S, 6, PADDED), `inverse` (S, 6, 6): as `cut_patch` has them.
    """
    wide = np.zeros((SIDE + 2, SIDE + 2), dtype=np.float32)
    for n in range(len(uv)):
        at = slot[n]
        cut_patch(words, uv[n, 0], uv[n, 1], wide, grey[at], steepest[at], inverse[at], damping)


_folder = code_folder(Path(__file__))
find_features_compiled = compiled(find_features, _folder)
cut_patches_compiled = compiled(cut_patches, _folder)
