"""Pyramidal Lucas-Kanade optical flow with predicted starts, checked by going back.

The pyramid of an image is built once, for all that is looked for from and in it. The
forward-backward check is that of Z. Kalal et al., ICPR 2010.
"""

from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from ovmot.frontend.klt_kernel import BACK_LEVELS, klt_track_compiled, margin_of
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.settings import TrackerSettings

_SEARCHED_HALF = 4  # pixels of the half-size image around a patch that is searched for
_LEAST_ALIKE = 0.8  # correlation
_COMMON, _MAX_RESIDUAL_RATIO = 0.9, 2.0  # a find is chance beyond twice what nine in ten are unlike


@dataclass(frozen=True, slots=True)
class Pyramid:
    """An image from fine to coarse, as `klt_kernel` takes it, for windows of side `window`."""

    levels: tuple[npt.NDArray[np.float32], ...]
    window: int


def build_pyramid(image: Image, settings: TrackerSettings) -> Pyramid:
    """Each level half the size of the last one, and none smaller than the window."""
    window = settings.klt_window_px
    margin = margin_of(window)
    n_levels = max(settings.klt_levels, settings.klt_near_levels, BACK_LEVELS)
    levels: list[npt.NDArray[np.float32]] = []
    while len(levels) < n_levels and (not levels or min(image.shape) > window):
        padded = cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REFLECT_101)
        levels.append(padded.astype(np.float32))
        image = np.asarray(cv2.pyrDown(image))
    return Pyramid(tuple(levels), window)


@dataclass(frozen=True, slots=True)
class Flow:
    """Where N points went: positions (N, 2), which were found (N,), and how unlike the patch there
    is (N,), the mean difference in grey levels."""

    uv: FloatArray
    found: BoolArray
    photometric_residual: FloatArray


def follow(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    start: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
) -> Flow:
    """Where `points` (N, 2) of `source` are in `target`, near predicted places.

    `start` (N, 2): where to begin the search; NaN means at `points`. Few levels of the pyramid: a
    coarse patch is as large as a body, and what is larger around it would pull it along.
    """
    return _follow_halves(source, target, points, start, settings.klt_near_levels, workers)


def recover_lost(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    flow: Flow,
    starts: FloatArray,
    around: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
) -> Flow:
    """The flow, with what it lost looked for again: near `starts` (H, N, 2), then far `around`.

    The starts come in order of trust, NaN for none; around the last places (N, 2) the whole pyramid
    is searched.
    A further look finds something wherever it looks, so that what it finds must be as like as what
    the first look found.
    """
    if not flow.found.any():
        return flow
    bound = _MAX_RESIDUAL_RATIO * float(np.quantile(flow.photometric_residual[flow.found], _COMMON))
    uv, found, photometric_residual = (
        flow.uv.copy(),
        flow.found.copy(),
        flow.photometric_residual.copy(),
    )
    levels = [settings.klt_near_levels] * len(starts) + [settings.klt_levels]
    for start, n_levels in zip((*starts, around), levels, strict=True):
        lost = np.flatnonzero(~found & np.isfinite(start).all(axis=1))
        again = _follow_halves(source, target, points[lost], start[lost], n_levels, workers)
        uv[lost], photometric_residual[lost] = again.uv, again.photometric_residual
        found[lost] = again.found & (again.photometric_residual < bound)
    return Flow(uv, found, photometric_residual)


def best_matching_places(
    source: Pyramid, target: Pyramid, points: FloatArray, around: FloatArray, reach_px: float
) -> FloatArray:
    """Where in `target` the patches of `points` (N, 2) of `source` are likest (N, 2), NaN for none.

    They are sought `reach_px` to either side of places (N, 2), a quarter of it up and down: bodies
    go along the ground. On the half-size image, by correlation; flow only finds what is not much
    farther than its window is wide.
    """
    found = np.full(points.shape, np.nan)
    if len(source.levels) < 2:
        return found
    margin, half = margin_of(source.window), _SEARCHED_HALF
    before, after = source.levels[1], target.levels[1]
    size = np.array(after.shape[::-1])
    reach = (np.array([0.5, 0.125]) * reach_px).astype(np.int64) + half
    centre = (0.5 * points).round().astype(np.int64) + margin
    middle = (0.5 * around).round().astype(np.int64) + margin
    low, high = np.maximum(middle - reach, 0), np.minimum(middle + reach + 1, size)
    inside = ((centre >= half) & (centre < size - half) & (high - low > 2 * half)).all(axis=1)
    for k in np.flatnonzero(inside):
        (u, v), (left, top), (right, bottom) = centre[k], low[k], high[k]
        patch = before[v - half : v + half + 1, u - half : u + half + 1]
        score = cv2.matchTemplate(after[top:bottom, left:right], patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, corner = cv2.minMaxLoc(score)
        if best > _LEAST_ALIKE:
            found[k] = points[k] + 2.0 * (low[k] + np.array(corner) + half - centre[k])
    return found


def _follow_halves(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    start: FloatArray,
    n_levels: int,
    workers: Executor,
) -> Flow:
    """Halves of the points in two threads; each point by itself, whatever the split."""
    begin = np.where(np.isfinite(start), start, points)
    half = (len(points) + 1) // 2
    jobs = [
        workers.submit(
            klt_track_compiled, source.levels, target.levels, source.window,
            points[part], begin[part], min(n_levels, len(source.levels)),
        )
        for part in (slice(0, half), slice(half, None))
    ]  # fmt: skip
    uv, found, photometric_residual = zip(*(job.result() for job in jobs), strict=True)
    return Flow(np.concatenate(uv), np.concatenate(found), np.concatenate(photometric_residual))
