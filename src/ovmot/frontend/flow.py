"""Pyramidal Lucas-Kanade optical flow with predicted starts, checked by going back.

J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", 2000; the
forward-backward check is Z. Kalal et al., ICPR 2010.
"""

from concurrent.futures import Executor

import cv2
import numpy as np

from ovmot.config import TrackerSettings
from ovmot.geometry.arrays import BoolArray, FloatArray, Image

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_BACK_LEVEL = 1  # the way back starts where it should end: two levels are enough
_MAX_ROUND_TRIP_PX = 0.7
_MIN_EIGENVALUE = 1e-4


def follow(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    settings: TrackerSettings,
    workers: Executor,
) -> tuple[FloatArray, BoolArray]:
    """Positions (N, 2) in `target` of `points` (N, 2) of `source`, and which were found (N,).

    `start` (N, 2): where to begin the search; NaN means at `points`. Halves of the points run in
    two threads, each point by itself, so the answer does not depend on the split.
    """
    if len(points) == 0:
        return np.empty((0, 2)), np.empty(0, dtype=np.bool_)
    begin = np.where(np.isfinite(start), start, points)
    half = (len(points) + 1) // 2
    jobs = [
        workers.submit(_follow_there_and_back, source, target, points[part], begin[part], settings)
        for part in (slice(0, half), slice(half, None))
        if len(points[part])
    ]
    found = [job.result() for job in jobs]
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


def _follow_there_and_back(
    source: Image,
    target: Image,
    points: FloatArray,
    start: FloatArray,
    settings: TrackerSettings,
) -> tuple[FloatArray, BoolArray]:
    window = (settings.klt_window_px, settings.klt_window_px)
    p, q = points.astype(np.float32), start.astype(np.float32)
    there, status, _ = cv2.calcOpticalFlowPyrLK(
        source, target, p, q, winSize=window, maxLevel=settings.klt_levels - 1, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_MIN_EIGENVALUE,
    )  # fmt: skip
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(
        target, source, there, p.copy(), winSize=window, maxLevel=_BACK_LEVEL, criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_MIN_EIGENVALUE,
    )  # fmt: skip
    returned = np.linalg.norm(back - p, axis=1) < _MAX_ROUND_TRIP_PX
    ok = (status.ravel() == 1) & (status_back.ravel() == 1) & returned
    return there.astype(np.float64), ok
