"""Pyramidal Lucas-Kanade optical flow with predicted starts, checked by going back.

J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", 2000; the
forward-backward check is Z. Kalal et al., ICPR 2010.
"""

from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np

from ovmot.config import TrackerSettings
from ovmot.geometry.arrays import BoolArray, FloatArray, Image

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_COMMON, _UNLIKE = 0.9, 2.0  # a find is chance beyond twice what nine in ten are unlike
_BACK_LEVEL = 1  # the way back starts where it should end: two levels are enough
_MAX_ROUND_TRIP_PX = 0.7
_MIN_EIGENVALUE = 1e-3


@dataclass(frozen=True, slots=True)
class Flow:
    """Where N points went: positions (N, 2), which were found (N,), and how unlike the patch there
    is (N,), the mean difference in grey levels."""

    uv: FloatArray
    found: BoolArray
    unlikeness: FloatArray


def follow(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
) -> Flow:
    """Where `points` (N, 2) of `source` are in `target`, near predicted places.

    `start` (N, 2): where to begin the search; NaN means at `points`. Few levels of the pyramid: a
    coarse patch is as large as a body, and what is larger around it would pull it along.
    """
    return _follow_halves(
        source, target, points, start, settings.klt_near_levels, settings, workers
    )


def follow_lost(
    source: Image,
    target: Image,
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
    bound = _UNLIKE * float(np.quantile(flow.unlikeness[flow.found], _COMMON))
    uv, found, unlikeness = flow.uv.copy(), flow.found.copy(), flow.unlikeness.copy()
    levels = [settings.klt_near_levels] * len(starts) + [settings.klt_levels]
    for start, n_levels in zip((*starts, around), levels, strict=True):
        lost = np.flatnonzero(~found & np.isfinite(start).all(axis=1))
        again = _follow_halves(
            source, target, points[lost], start[lost], n_levels, settings, workers
        )
        uv[lost], unlikeness[lost] = again.uv, again.unlikeness
        found[lost] = again.found & (again.unlikeness < bound)
    return Flow(uv, found, unlikeness)


def _follow_halves(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    n_levels: int,
    settings: TrackerSettings,
    workers: Executor,
) -> Flow:
    """Halves of the points in two threads; each point by itself, whatever the split."""
    if len(points) == 0:
        return Flow(np.empty((0, 2)), np.empty(0, dtype=np.bool_), np.empty(0))
    begin = np.where(np.isfinite(start), start, points)
    half = (len(points) + 1) // 2
    jobs = [
        workers.submit(
            _follow_there_and_back, source, target, points[part], begin[part], n_levels, settings
        )
        for part in (slice(0, half), slice(half, None))
        if len(points[part])
    ]
    done = [job.result() for job in jobs]
    return Flow(
        np.concatenate([flow.uv for flow in done]),
        np.concatenate([flow.found for flow in done]),
        np.concatenate([flow.unlikeness for flow in done]),
    )


def _follow_there_and_back(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    n_levels: int,
    settings: TrackerSettings,
) -> Flow:
    window = (settings.klt_window_px, settings.klt_window_px)
    p, q = points.astype(np.float32), start.astype(np.float32)
    there, status, unlikeness = cv2.calcOpticalFlowPyrLK(
        source, target, p, q, winSize=window, maxLevel=n_levels - 1, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_MIN_EIGENVALUE,
    )  # fmt: skip
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(
        target, source, there, p.copy(), winSize=window, maxLevel=_BACK_LEVEL, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_MIN_EIGENVALUE,
    )  # fmt: skip
    returned = np.linalg.norm(back - p, axis=1) < _MAX_ROUND_TRIP_PX
    found = (status.ravel() == 1) & (status_back.ravel() == 1) & returned
    return Flow(there.astype(np.float64), found, unlikeness.ravel().astype(np.float64))
