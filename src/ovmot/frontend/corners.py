"""New corners: FAST over the whole image, spread by a grid."""

import cv2
import numpy as np

from ovmot.config import TrackerSettings
from ovmot.geometry.arrays import FloatArray, Image

_BORDER_PX = 8


def detect_corners(
    image: Image, existing: FloatArray, n_wanted: int, settings: TrackerSettings
) -> FloatArray:
    """Up to `n_wanted` new corners (M, 2), strongest first, away from `existing` (N, 2).

    E. Rosten & T. Drummond, ECCV 2006. Each grid cell may fill up to its even share of
    `max_features`; no two corners come nearer than `min_distance_px`.
    """
    if n_wanted <= 0:
        return np.empty((0, 2))
    detector = cv2.FastFeatureDetector.create(settings.fast_threshold, nonmaxSuppression=True)
    keypoints = detector.detect(image)
    if not keypoints:
        return np.empty((0, 2))
    points = np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float64)
    response = np.fromiter((k.response for k in keypoints), np.float64, len(keypoints))
    height, width = image.shape
    inside = (
        (points[:, 0] >= _BORDER_PX) & (points[:, 0] < width - _BORDER_PX)
        & (points[:, 1] >= _BORDER_PX) & (points[:, 1] < height - _BORDER_PX)
    )  # fmt: skip
    points, response = points[inside], response[inside]
    points = _best_of_each_bin(points, response, settings.min_distance_px, width)
    return _spread(points, existing, n_wanted, (width, height), settings)


def _best_of_each_bin(
    points: FloatArray, response: FloatArray, side: float, width: int
) -> FloatArray:
    """The strongest corner of each bin of `side` pixels, strongest first."""
    order = np.argsort(-response, kind="stable")
    points = points[order]
    bins = (points // side).astype(np.int64)
    _, first = np.unique(bins[:, 1] * (width + 1) + bins[:, 0], return_index=True)
    strongest: FloatArray = points[np.sort(first)]
    return strongest


def _spread(
    points: FloatArray,
    existing: FloatArray,
    n_wanted: int,
    size: tuple[int, int],
    settings: TrackerSettings,
) -> FloatArray:
    """Take corners in order while their cell has room and no taken one is too near."""
    cell = settings.grid_cell_px
    columns, rows = -(-size[0] // cell), -(-size[1] // cell)
    share = -(-settings.max_features // (columns * rows))
    room = np.full((rows, columns), share)
    occupied = np.zeros((size[1], size[0]), dtype=np.uint8)
    radius = round(settings.min_distance_px)
    for u, v in existing:
        room[min(int(v) // cell, rows - 1), min(int(u) // cell, columns - 1)] -= 1
        cv2.circle(occupied, (round(u), round(v)), radius, 255, -1)
    taken: list[FloatArray] = []
    for point in points:
        u, v = int(point[0]), int(point[1])
        if room[v // cell, u // cell] <= 0 or occupied[v, u]:
            continue
        taken.append(point)
        if len(taken) == n_wanted:
            break
        room[v // cell, u // cell] -= 1
        cv2.circle(occupied, (u, v), radius, 255, -1)
    return np.array(taken).reshape(-1, 2)
