"""The search for left features in the right image, those whose depth is not known among them."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ovmot.cameras.lens_kernel import packed_camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.epipolar_scan_kernel import ScanRules, scan_curves_compiled
from ovmot.frontend.feature_search import (
    LIKELY_CORRELATION,
    NOISE,
    RATIO,
    Found,
    Sought,
    find_features,
    near_levels,
    recover_lost,
)
from ovmot.frontend.klt_kernel import margin_of
from ovmot.frontend.klt_tracker import TrackedPoints
from ovmot.frontend.preprocessing import View
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.settings import TrackerSettings

_MOST_DISPARITY = 1.0 / 8.0
"""Of the image's width: 2.6 m of KITTI's rig, 0.6 m of EuRoC's."""


class Pair(NamedTuple):
    """Both views of a frame, the N features of the left one, and the cameras."""

    left: View
    right: View
    points: TrackedPoints
    rig: StereoRig


def search_by_scan(
    sought: Sought, pair: Pair, start: FloatArray, settings: TrackerSettings, helper: Executor
) -> Found:
    """The features in the right view, from predicted pixels `start` (N, 2).

    One without a depth is looked for along its epipolar curve first, and lost if it fits at two
    places there. Its patch is then aligned by itself, without flow, as it is where flow has led to
    none in an earlier frame.
    """
    unknown = np.isnan(pair.points.depth)
    scanned, ambiguous = scan_epipolar(pair, unknown)
    placed = np.isfinite(scanned[:, 0])
    start = np.where(placed[:, None], scanned, start)
    alone = placed | (unknown & (pair.points.track_length > 0))
    n_levels = np.where(alone, 0, near_levels(settings))
    seen = find_features(sought, pair.right, start, n_levels, helper)
    return replace(seen, found=seen.found & ~ambiguous)


def search_by_flow(
    sought: Sought, pair: Pair, start: FloatArray, settings: TrackerSettings, helper: Executor
) -> Found:
    """The same by optical flow from `start`, which takes nothing else from the extrinsics.

    The depth of a new feature is a guess: it is sought through the whole pyramid, too. One that has
    had no match so far has none by flow: its patch alone is tried again.
    """
    new = pair.points.track_length == 0
    unmatched = ~new & np.isnan(pair.points.depth)
    n_levels = np.where(unmatched, 0, near_levels(settings))
    first = find_features(sought, pair.right, start, n_levels, helper)
    far = np.where(new[:, None], start, np.nan)[None]
    return recover_lost(sought, pair.right, first, far, settings, helper)


RightSearch = Callable[[Sought, Pair, FloatArray, TrackerSettings, Executor], Found]

RIGHT_SEARCHES: dict[str, RightSearch] = {"scan": search_by_scan, "flow": search_by_flow}
"""By the setting `tracker.stereo_search`."""


def scan_epipolar(pair: Pair, wanted: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Right pixels (N, 2) where the `wanted` features (N,) fit best, to within a pixel or two, NaN
    where nowhere; and which of them fit as well elsewhere (N,).

    A row of windows that is matched to its neighbours is at a wrong depth, and seems to move.
    """
    left, right, points, rig = pair
    if min(len(left.pyramid.levels), len(right.pyramid.levels)) < 2:
        return np.full((len(points), 2), np.nan), np.zeros(len(points), np.bool_)
    least_depth = rig.baseline * left.camera.fx / (_MOST_DISPARITY * left.camera.width)
    return scan_curves_compiled(
        left.pyramid.levels[1], right.pyramid.levels[1], margin_of(left.pyramid.window),
        points.uv, points.xy, wanted, rig.T_cam1_cam0, *packed_camera(right.camera),
        ScanRules(least_depth, LIKELY_CORRELATION, RATIO, NOISE),
    )  # fmt: skip
