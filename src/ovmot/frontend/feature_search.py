"""The search for features in another image, from predicted places: patches, flow, templates."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ovmot.frontend.feature_kernel import ALIGNED, LOST, find_features_compiled
from ovmot.frontend.klt_kernel import margin_of
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import Pyramid, View
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray
from ovmot.runtime import do_together
from ovmot.settings import TrackerSettings

MIN_CORRELATION = 0.85
"""Normalized cross-correlation from which on two patches are taken as views of one point."""
SURE_CORRELATION = 0.95
"""The same without optical flow to lead there: a tenth of the variance is unlike at most, while a
warp that is free to bend reaches the other bound on some wrong texture within reach."""

LIKELY_CORRELATION = float(np.sqrt(0.5))
"""From which on half of the variance is explained: a place worth a closer look."""
RATIO = 0.8
"""Of the distances of the best match and of the next: D. Lowe, IJCV 2004, fig. 11."""
NOISE = 2.0
"""Grey levels, of a camera's picture with its contrast corrected."""


@dataclass(frozen=True, slots=True)
class Found:
    """Where N features are: pixels `uv` (N, 2), `warp` (N, 2, 2) of their patches, and which were
    found at all (N,), and which fit their first patch (N,)."""

    uv: FloatArray
    warp: FloatArray
    found: BoolArray
    fits: BoolArray


@dataclass(frozen=True, slots=True)
class Sought:
    """N features to look for: where they are in the image of `pyramid`, pixels `uv` (N, 2), and the
    slots (N,) of their patches in `store`."""

    pyramid: Pyramid
    uv: FloatArray
    store: PatchStore
    slot: IntArray


def find_features(
    sought: Sought, view: View, start: FloatArray, n_levels: int | IntArray, helper: Executor
) -> Found:
    """Where the features are in a view, from predicted pixels `start` (N, 2), NaN: where they were.

    The first patch is aligned with the predicted place. Where it does not fit, optical flow on
    `n_levels` of the pyramid (of all, or (N,)), there and back, leads to where it is aligned again;
    with none it is lost. The `helper` takes a part of the features; each is sought by itself.
    """
    starts = np.where(np.isfinite(start), start, sought.uv)[None]
    levels = np.full(len(start), n_levels, dtype=np.int64)[None]
    found = _Filled(sought.uv.copy(), sought.store.warp[sought.slot], _all_lost(len(start)))
    every = np.arange(len(start))
    _find(sought, view, every, starts, levels, found, helper, must_fit=False)
    return Found(found.uv, found.warp, found.state != LOST, found.state == ALIGNED)


def near_levels(settings: TrackerSettings) -> int:
    """Levels of the pyramid that lie within reach of a predicted place.

    At the coarsest ones a window is as large as a body, and the background in it would pull it
    along.
    """
    return max(settings.klt_levels - 2, 1)


def recover_lost(
    sought: Sought,
    view: View,
    first: Found,
    places: FloatArray,
    settings: TrackerSettings,
    helper: Executor,
) -> Found:
    """The features, with lost ones sought again from other `places` (H, N, 2).

    They come in order of trust, NaN for none; around the last ones the whole pyramid is searched. A
    repeated search finds something wherever it looks, so that the first patch must fit.
    """
    lost = np.flatnonzero(~first.found & np.isfinite(places[..., 0]).any(axis=0))
    if not len(lost):
        return first
    near, whole = near_levels(settings), settings.klt_levels
    levels = np.full(places.shape[:2], near, dtype=np.int64)
    levels[-1] = whole
    again = _Filled(first.uv.copy(), first.warp.copy(), _all_lost(len(first.uv)))
    _find(sought, view, lost, places, levels, again, helper, must_fit=True)
    fits = again.state == ALIGNED
    return Found(again.uv, again.warp, first.found | fits, first.fits | fits)


def only_fitting(now: Found, required: BoolArray) -> Found:
    """The features without those that must fit their patch, `required` (N,), and do not."""
    return replace(now, found=now.found & (now.fits | ~required))


def match_templates(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    around: FloatArray,
    reach_px: FloatArray,
) -> FloatArray:
    """Positions (N, 2) in `target` that correlate best with the patches of `points` (N, 2).

    They are sought `reach_px` (N,) to either side of `around` (N, 2) and a quarter of it up and
    down, since bodies move along the ground; NaN below `MIN_CORRELATION`, and where two places fit
    as well. Normalized cross-correlation of windows on the half-size images: optical flow does not
    reach much farther than its window.
    """
    found = np.full(points.shape, np.nan)
    if len(source.levels) < 2:
        return found
    margin, half = margin_of(source.window), source.window // 2
    before, after = source.levels[1], target.levels[1]
    size = np.array(after.shape[::-1])
    reach = (np.outer(reach_px, [0.5, 0.125])).astype(np.int64) + half
    centre = (0.5 * points).round().astype(np.int64) + margin
    middle = (0.5 * around).round().astype(np.int64) + margin
    low, high = np.maximum(middle - reach, 0), np.minimum(middle + reach + 1, size)
    inside = ((centre >= half) & (centre < size - half) & (high - low > 2 * half)).all(axis=1)
    for k in np.flatnonzero(inside):
        (u, v), (left, top), (right, bottom) = centre[k], low[k], high[k]
        patch = before[v - half : v + half + 1, u - half : u + half + 1]
        score = cv2.matchTemplate(after[top:bottom, left:right], patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, corner = cv2.minMaxLoc(score)
        if best > MIN_CORRELATION and not _is_ambiguous(score, corner, half, float(patch.std())):
            found[k] = points[k] + 2.0 * (low[k] + np.array(corner) + half - centre[k])
    return found


def _is_ambiguous(score: AnyArray, best: Sequence[int], half: int, contrast: float) -> bool:
    """Does a patch fit elsewhere as well as at the `best` place (2,) of a map of correlations?

    The next place is the best of those a half window away or more. Their distances, the roots of 1
    less the correlation, are in a smaller ratio than D. Lowe's. What noise takes off every
    correlation of a patch of this contrast, in grey levels, tells nothing.
    """
    u, v = best
    others = score.copy()
    others[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1] = -1.0
    noise = (NOISE / max(contrast, NOISE)) ** 2
    next_best = float(others.max())
    return 1.0 - float(score[v, u]) + noise > RATIO**2 * (1.0 - next_best + noise)


class _Filled(NamedTuple):
    """What a search fills: pixels (N, 2), warps (N, 2, 2), states (N,)."""

    uv: FloatArray
    warp: FloatArray
    state: npt.NDArray[np.uint8]


def _all_lost(n: int) -> npt.NDArray[np.uint8]:
    return np.full(n, LOST, dtype=np.uint8)


def _find(
    sought: Sought,
    view: View,
    row: IntArray,
    starts: FloatArray,
    n_levels: IntArray,
    found: _Filled,
    helper: Executor,
    *,
    must_fit: bool,
    portion: int = 256,
    max_steps: int = 12,
    small_step_px: float = 0.005,
) -> None:
    """Features `row` (M,) from their `starts` (H, N, 2), in portions that two threads share.

    An alignment takes at most `max_steps`, and is done at one below `small_step_px`: what stops
    earlier stays nearer to the prediction, and an error that agrees with the filter does not
    average out.
    """
    store, levels = sought.store, np.minimum(n_levels, len(view.pyramid.levels))

    def search(first: int) -> None:
        find_features_compiled(
            sought.pyramid.levels, view.pyramid.levels, view.words, view.pyramid.window,
            store.patches, sought.slot, store.warp, sought.uv,
            row[first : first + portion], starts, levels, must_fit,
            MIN_CORRELATION, SURE_CORRELATION, max_steps, small_step_px, *found,
        )  # fmt: skip

    do_together([partial(search, first) for first in range(0, len(row), portion)], helper)
