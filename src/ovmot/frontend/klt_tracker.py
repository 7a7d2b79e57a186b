"""The KLT tracker of one camera: corners tracked from image to image."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ovmot.frontend.corners import fine_cell_px, new_corners
from ovmot.frontend.epipolar import two_view_inliers
from ovmot.frontend.feature_kernel import keep_found_compiled
from ovmot.frontend.feature_search import (
    Sought,
    find_features,
    match_templates,
    near_levels,
    only_fitting,
    recover_lost,
)
from ovmot.frontend.hidden_features import (
    REPLY_FRAMES,
    ExpectedPlaces,
    HiddenPatches,
    hidden_now,
    none_expected,
    none_hidden,
    seen_again,
)
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.prediction import predict_tracks, unexplained_flow
from ovmot.frontend.prediction_kernel import other_places_compiled
from ovmot.frontend.preprocessing import Pyramid, View
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.physics import RIG_REACH_M
from ovmot.settings import TrackerSettings

_NEW = 2
"""Track length below which nothing is known of a point's own motion: the flow of two intervals
tells a motion from a mismatch."""
_MAX_SCALE = 1.7
"""A patch that is seen larger or smaller by more is cut anew."""


@dataclass(frozen=True, slots=True)
class TrackedPoints:
    """N features in the present image of a camera, the tracked ones first, in their old order.

    `uv` pixels and `xy` normalized coordinates (N, 2); `track_length` (N,): images through which
    the feature has been tracked, 0 for a new one; `depth` (N,) predicted in metres or NaN;
    `extra_flow` (N, 2): image motion in pixels beyond that of a static point; `inlier` (N,) of the
    two-view test. `slot` (N,) of its patch in the camera's `PatchStore`.
    """

    feature_id: IntArray
    uv: FloatArray
    xy: FloatArray
    track_length: IntArray
    depth: FloatArray
    extra_flow: FloatArray
    inlier: BoolArray
    slot: IntArray

    def __len__(self) -> int:
        return len(self.feature_id)


class Expected(NamedTuple):
    """What is known of an image before it is looked at.

    `p_before` (N, 3), metres: the last points in the camera's frame of then, NaN where unknown, and
    `p_predicted` (N, 3) where in that frame they are now, if they move on their own. `T_now_before`
    (4, 4): predicted motion of the camera since. `way_m`: how far a body that has just come into
    view may have moved since. `hidden`: where features are that were lost.
    """

    p_before: FloatArray
    p_predicted: FloatArray
    T_now_before: FloatArray
    way_m: float
    hidden: ExpectedPlaces


def static_world(p_before: FloatArray, T_now_before: FloatArray) -> Expected:
    """Points (N, 3) that are all at rest."""
    return Expected(p_before, p_before, T_now_before, 0.0, none_expected())


class FeatureIds:
    """Gives out ids, none of them twice."""

    def __init__(self) -> None:
        self._next = 0

    def take(self, count: int) -> IntArray:
        """The next ids (count,)."""
        self._next += count
        return np.arange(self._next - count, self._next, dtype=np.int64)


class KltTracker:
    """Tracks corners through one camera's images; remembers the last image and its points."""

    def __init__(self, settings: TrackerSettings, helper: Executor, ids: FeatureIds) -> None:
        self._settings = settings
        self._helper = helper
        self._ids = ids
        self._pyramid: Pyramid | None = None
        self.points = no_points()
        self.patches = PatchStore()
        self._hidden = none_hidden()

    def step(
        self, view: View, expected: Expected, focus: Image | None, dynamic_id: IntArray
    ) -> TrackedPoints:
        """The points of this view: those of the last one that are tracked, and new corners.

        `focus` (height, width): not zero where more corners are wanted. `dynamic_id` (D,): features
        that are none of the static ones of which a number is asked for.
        """
        last, tracked = self.points, self._track(view, expected)
        lost = np.flatnonzero(~contained(last.feature_id, np.sort(tracked.feature_id)))
        self._hidden = hidden_now(
            self._hidden, last.feature_id[lost], last.slot[lost], expected.hidden.feature_id
        )
        self.patches.keep(np.concatenate([tracked.slot, self._hidden.slot]))
        points = self._with_corners(view, tracked, focus, dynamic_id)
        self.points = self._with_old_ids(view, points, expected.hidden, dynamic_id)
        self._pyramid = view.pyramid
        return self.points

    def take_over(self, view: View, points: TrackedPoints) -> None:
        """Go on with `points`, found in this view otherwise; their patches are cut here."""
        self.patches, self._hidden = PatchStore(), none_hidden()
        self.points = replace(points, slot=self.patches.add(view.words, points.uv))
        self._pyramid = view.pyramid

    def _track(self, view: View, expected: Expected) -> TrackedPoints:
        """The last image's points in this one, without those that are lost."""
        p_before, p_predicted, T_now_before, way_m, _ = expected
        last, camera = self.points, view.camera
        cell_px = fine_cell_px(view.image.shape, self._settings)
        if self._pyramid is None:
            return last
        # predict: by the camera's motion, the point's own, or its flow beyond that of the last time
        static_uv, start, depth, moves = predict_tracks(
            last.uv, last.xy, p_before, p_predicted, last.extra_flow, T_now_before, camera
        )
        # search there, and in other places for what is lost
        sought = Sought(self._pyramid, last.uv, self.patches, last.slot)
        first = find_features(sought, view, start, near_levels(self._settings), self._helper)
        # a patch of the last image fits this one; an older one may be seen otherwise by now
        first = only_fitting(first, self.patches.is_new[last.slot])
        self.patches.is_new[:] = False
        # a motion of less than half a window is found from the static position
        half_px = 0.5 * self._settings.klt_window_px
        places = other_places_compiled(last.uv, static_uv, start, first.uv, first.found, half_px)
        # what would be nearer is the rig's own body, or wrong
        reach_px = camera.fx * way_m / np.maximum(p_before[:, 2], RIG_REACH_M)
        unknown = ~first.found & ~moves & (reach_px > half_px)
        self._search(view, static_uv, unknown, reach_px, places[2])
        now = recover_lost(sought, view, first, places, self._settings, self._helper)
        xy = camera.normalize(now.uv)
        rows, stale = keep_found_compiled(
            now.uv, xy, now.warp, now.found, now.fits, view.compact_mask,
            camera.width, camera.height, view.pyramid.window // 2, _MAX_SCALE,
        )  # fmt: skip
        uv, xy, slot = now.uv[rows], xy[rows], last.slot[rows]
        # patches that do not fit any more, or are seen at another scale, are cut anew
        self.patches.warp[slot] = now.warp[rows]
        self.patches.renew(view.words, uv[stale], slot[stale])
        # two-view test
        threshold = self._settings.two_view_threshold_px / camera.fx
        inlier = two_view_inliers(last.xy[rows], xy, T_now_before[:3, :3], threshold)
        return TrackedPoints(
            feature_id=last.feature_id[rows],
            uv=uv,
            xy=xy,
            track_length=last.track_length[rows] + 1,
            depth=depth[rows],
            extra_flow=unexplained_flow(uv, static_uv[rows], inlier, 4.0 * cell_px),
            inlier=inlier,
            slot=slot,
        )

    def _search(
        self,
        view: View,
        static_uv: FloatArray,
        lost: BoolArray,
        reach_px: FloatArray,
        out: FloatArray,
    ) -> None:
        """Fill in where new ones of the `lost` points (N,) correlate best (N, 2), within `reach_px`
        (N,) of where they would be at rest: they may be of a body that has just come into view."""
        last = self.points
        rows = np.flatnonzero(lost & (last.track_length < _NEW))
        rows = rows[view.contains(static_uv[rows])]
        if self._pyramid is not None and len(rows):
            out[rows] = match_templates(
                self._pyramid, view.pyramid, last.uv[rows], static_uv[rows], reach_px[rows]
            )

    def _with_corners(
        self, view: View, tracked: TrackedPoints, focus: Image | None, dynamic_id: IntArray
    ) -> TrackedPoints:
        """The tracked points and as many new corners as there is room for."""
        dynamic = contained(tracked.feature_id, np.sort(dynamic_id))
        uv = new_corners(view.image, view.mask, tracked.uv, dynamic, focus, self._settings)
        xy = view.camera.normalize(uv)
        uv, xy = uv[np.isfinite(xy[:, 0])], xy[np.isfinite(xy[:, 0])]
        n = len(uv)
        return TrackedPoints(
            feature_id=np.concatenate([tracked.feature_id, self._ids.take(n)]),
            uv=np.concatenate([tracked.uv, uv]),
            xy=np.concatenate([tracked.xy, xy]),
            track_length=np.concatenate([tracked.track_length, np.zeros(n, dtype=np.int64)]),
            depth=np.concatenate([tracked.depth, np.full(n, np.nan)]),
            extra_flow=np.concatenate([tracked.extra_flow, np.zeros((n, 2))]),
            inlier=np.concatenate([tracked.inlier, np.ones(n, dtype=np.bool_)]),
            slot=np.concatenate([tracked.slot, self.patches.add(view.words, uv)]),
        )

    def _with_old_ids(
        self, view: View, points: TrackedPoints, expected: ExpectedPlaces, dynamic_id: IntArray
    ) -> TrackedPoints:
        """The points, those that show hidden features, and are no object's, with their ids."""
        hidden = self._hidden
        rows = np.flatnonzero(~contained(points.feature_id, np.sort(dynamic_id)))
        again = seen_again(
            hidden, expected, self.patches, view, points.uv[rows], points.slot[rows], self._helper
        )
        if not len(again.hidden):
            return points
        at, old = rows[again.other], again.hidden
        feature_id, slot = points.feature_id.copy(), points.slot.copy()
        uv, xy, length = points.uv.copy(), points.xy.copy(), points.track_length.copy()
        feature_id[at], slot[at], uv[at] = hidden.feature_id[old], hidden.slot[old], again.uv
        xy[at], length[at] = view.camera.normalize(again.uv), REPLY_FRAMES
        self.patches.warp[slot[at]] = again.warp
        rest = np.delete(np.arange(len(hidden.slot)), old)
        self._hidden = HiddenPatches(*(values[rest] for values in hidden))
        self.patches.keep(np.concatenate([slot, self._hidden.slot]))
        return replace(points, feature_id=feature_id, uv=uv, xy=xy, track_length=length, slot=slot)


def no_points() -> TrackedPoints:
    """Those before the first image."""
    two, ints = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    none = np.empty(0, dtype=np.bool_)
    return TrackedPoints(ints, two, two, ints, np.empty(0), two, none, ints)
