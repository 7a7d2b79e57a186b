"""Pyramidal Lucas-Kanade optical flow (KLT) from predicted positions, with a check backwards.

The search itself is `klt_kernel`; the forward-backward check is that of Z. Kalal et al., ICPR 2010.
"""

from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np

from ovmot.frontend.klt_kernel import klt_track_compiled, margin_of
from ovmot.frontend.preprocessing import Pyramid
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.settings import TrackerSettings

MIN_CORRELATION = 0.85
"""Normalized cross-correlation from which on two patches are taken as views of one point."""


@dataclass(frozen=True, slots=True)
class Flow:
    """Where N points went: pixels `uv` (N, 2), which were `found` (N,), and the
    `photometric_residual` (N,) there, the mean absolute difference in grey levels."""

    uv: FloatArray
    found: BoolArray
    photometric_residual: FloatArray


def track_points(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    start: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
) -> Flow:
    """Where `points` (N, 2) of `source` are in `target`, pixels, near predicted positions.

    `start` (N, 2): where to begin the search; NaN means at `points`. The coarsest levels of the
    pyramid are left out: see `near_levels`.
    """
    return _track_in_halves(source, target, points, start, near_levels(settings), workers)


def near_levels(settings: TrackerSettings) -> int:
    """Levels of the pyramid for a search around a predicted position: without the two coarsest,
    where a window is as large as a body, and the background in it would pull it along."""
    return max(settings.klt_levels - 2, 1)


def recover_lost(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    flow: Flow,
    starts: FloatArray,
    around: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
    *,
    probability: float = 0.95,
) -> Flow:
    """The flow, with lost points searched again: near `starts` (H, N, 2), then far `around` (N, 2).

    The starts come in order of trust, NaN for none; around the last positions the whole pyramid is
    searched. A repeated search finds something wherever it looks, so that its photometric residual
    must be one that the first search stays below with this `probability`.
    """
    if not flow.found.any():
        return flow
    bound = float(np.quantile(flow.photometric_residual[flow.found], probability))
    uv, found, residual = flow.uv.copy(), flow.found.copy(), flow.photometric_residual.copy()
    levels = [near_levels(settings)] * len(starts) + [settings.klt_levels]
    for start, n_levels in zip((*starts, around), levels, strict=True):
        lost = np.flatnonzero(~found & np.isfinite(start).all(axis=1))
        again = _track_in_halves(source, target, points[lost], start[lost], n_levels, workers)
        uv[lost], residual[lost] = again.uv, again.photometric_residual
        found[lost] = again.found & (again.photometric_residual < bound)
    return Flow(uv, found, residual)


def match_templates(
    source: Pyramid, target: Pyramid, points: FloatArray, around: FloatArray, reach_px: float
) -> FloatArray:
    """Positions (N, 2) in `target` that correlate best with the patches of `points` (N, 2).

    They are sought `reach_px` to either side of `around` (N, 2) and a quarter of it up and down,
    since bodies move along the ground; NaN below `MIN_CORRELATION`. Normalized cross-correlation
    of windows on the half-size images: optical flow does not reach much farther than its window.
    """
    found = np.full(points.shape, np.nan)
    if len(source.levels) < 2:
        return found
    margin, half = margin_of(source.window), source.window // 2
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
        if best > MIN_CORRELATION:
            found[k] = points[k] + 2.0 * (low[k] + np.array(corner) + half - centre[k])
    return found


def _track_in_halves(
    source: Pyramid,
    target: Pyramid,
    points: FloatArray,
    start: FloatArray,
    n_levels: int,
    workers: Executor,
) -> Flow:
    """Halves of the points in two threads; each point by itself, whatever the halves."""
    begin = np.where(np.isfinite(start), start, points)
    half = (len(points) + 1) // 2
    jobs = [
        workers.submit(
            klt_track_compiled, source.levels, target.levels, source.window,
            points[part], begin[part], min(n_levels, len(source.levels)),
        )
        for part in (slice(0, half), slice(half, None))
    ]  # fmt: skip
    uv, found, residual = zip(*(job.result() for job in jobs), strict=True)
    return Flow(np.concatenate(uv), np.concatenate(found), np.concatenate(residual))
