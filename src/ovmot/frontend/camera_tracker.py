"""Corners followed through the images of one camera."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ovmot.cameras.camera import Camera
from ovmot.frontend.corners import Spread, choose_corners, even_spread, fast_corners
from ovmot.frontend.flow import Pyramid, best_matching_places, follow, recover_lost
from ovmot.frontend.focus import focus_mask
from ovmot.frontend.patches import cut_patches, followed, no_patches
from ovmot.frontend.prediction import flow_nearby, predict_pixels, unexplained_flow
from ovmot.frontend.two_view import two_view_inliers
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.settings import TrackerSettings

Focus = tuple[FloatArray, FloatArray]
"""Pixels (N, 2) around which more corners are wanted, and radii (N,) in pixels."""

BORDER_PX = 3.0
"""Nothing is followed nearer than this to the picture's rim."""
_UNLIMITED = 100_000
_FRESH = 2  # hops up to which a point may be of a body that nothing is known of
_MOST_SEARCHED = 40
_REACH = 0.0625  # of the width, how far: 10 m/s at 10 m and 10 Hz in a view of 76 degrees


@dataclass(frozen=True, slots=True)
class View:
    """What one camera sees: its equalised image, the same as a `pyramid` for the flow and `smooth`
    for the alignment of patches, its mask if any, and its present calibration."""

    image: Image
    pyramid: Pyramid
    smooth: npt.NDArray[np.float32]
    mask: Image | None
    camera: Camera

    def shows(self, uv: FloatArray) -> BoolArray:
        """Which pixels (N, 2) lie inside the picture and are not masked."""
        return self.camera.inside(uv, BORDER_PX) & ~is_masked(uv, self.mask)


@dataclass(frozen=True, slots=True)
class CameraPoints:
    """N features in the present image of a camera, the followed ones first, in their old order.

    `uv` pixels and `xy` plane coordinates (N, 2), `track_length` (N,), `depth` (N,) expected in
    metres or NaN, `extra_flow` (N, 2) image motion beyond a resting point's, `inlier` (N,) of the
    two-view test.
    """

    feature_id: IntArray
    uv: FloatArray
    xy: FloatArray
    track_length: IntArray
    depth: FloatArray
    extra_flow: FloatArray
    inlier: BoolArray

    def __len__(self) -> int:
        return len(self.feature_id)


class FeatureIds:
    """Gives out ids, none of them twice."""

    def __init__(self) -> None:
        self._next = 0

    def take(self, count: int) -> IntArray:
        """The next ids (count,)."""
        self._next += count
        return np.arange(self._next - count, self._next, dtype=np.int64)


class CameraTracker:
    """Follows corners through one camera's images; remembers the last image and its points."""

    def __init__(self, settings: TrackerSettings, workers: Executor, ids: FeatureIds) -> None:
        self._settings = settings
        self._workers = workers
        self._ids = ids
        self._pyramid: Pyramid | None = None
        self.points = no_points()
        self.patches = no_patches()

    def step(
        self,
        view: View,
        p_before: FloatArray,
        p_moved: FloatArray,
        T_now_before: FloatArray,
        focus: Focus,
    ) -> CameraPoints:
        """The points of this view: those of the last one that are found again, and new corners.

        `p_before` (N, 3): where the last points were in the camera's frame of then, NaN where
        unknown, and `p_moved` where in that frame they should be now, if they move by themselves;
        `T_now_before` (4, 4): predicted motion of the camera since.
        """
        points = self._followed(view, p_before, p_moved, T_now_before)
        self.points = self._with_corners(view, points, focus)
        new = cut_patches(view.smooth, self.points.uv[len(points) :])
        self.patches = self.patches.joined(new)
        self._pyramid = view.pyramid
        return self.points

    def _followed(
        self, view: View, p_before: FloatArray, p_moved: FloatArray, T_now_before: FloatArray
    ) -> CameraPoints:
        """The last image's points in this one; those lost are gone."""
        old, camera = self.points, view.camera
        if self._pyramid is None:
            return old
        at_rest, _ = predict_pixels(old.xy, p_before, T_now_before, camera)
        start, depth = predict_pixels(old.xy, p_moved, T_now_before, camera)
        moves = np.isfinite(p_moved[:, 0]) & (p_moved != p_before).any(axis=1)
        start = np.where(moves[:, None], start, at_rest + old.extra_flow)
        pictures = self._pyramid, view.pyramid, old.uv
        flow = follow(*pictures, start, self._settings, self._workers)
        nearby = flow_nearby(old.uv, at_rest, flow.uv, flow.found)
        # not again where the first look began
        elsewhere = np.where((start != at_rest).any(axis=1)[:, None], at_rest, np.nan)
        searched = self._searched(view, p_before, moves, at_rest, flow.found)
        again = np.stack([nearby, elsewhere, searched])
        flow = recover_lost(*pictures, flow, again, at_rest, self._settings, self._workers)
        rows = np.flatnonzero(flow.found & view.shows(flow.uv))
        patches = self.patches.rows(rows)
        uv, patches = followed(patches, view.smooth, flow.uv[rows], self._workers)
        xy = camera.normalize(uv)
        ok = view.shows(uv) & np.isfinite(xy[:, 0])
        rows, uv, xy, self.patches = rows[ok], uv[ok], xy[ok], patches.rows(ok)
        threshold = self._settings.two_view_threshold_px / camera.fx
        inlier = two_view_inliers(old.xy[rows], xy, threshold)
        return CameraPoints(
            feature_id=old.feature_id[rows],
            uv=uv,
            xy=xy,
            track_length=old.track_length[rows] + 1,
            depth=depth[rows],
            extra_flow=unexplained_flow(uv, at_rest[rows], inlier),
            inlier=inlier,
        )

    def _searched(
        self,
        view: View,
        p_before: FloatArray,
        moves: BoolArray,
        at_rest: FloatArray,
        found: BoolArray,
    ) -> FloatArray:
        """Where new points in stereo that were lost are likest (N, 2), NaN for others: they may be
        of a body that has just come into view."""
        old = self.points
        fresh = ~found & (old.track_length < _FRESH) & ~moves & np.isfinite(p_before[:, 0])
        lost = np.flatnonzero(fresh & view.shows(at_rest))[:_MOST_SEARCHED]
        out = np.full(at_rest.shape, np.nan)
        if self._pyramid is not None and len(lost):
            reach_px = _REACH * view.image.shape[1]
            out[lost] = best_matching_places(
                self._pyramid, view.pyramid, old.uv[lost], at_rest[lost], reach_px
            )
        return out

    def _with_corners(self, view: View, points: CameraPoints, focus: Focus) -> CameraPoints:
        """The points and as many new corners as there is room for."""
        uv = self._new_corners(view, points.uv, focus)
        xy = view.camera.normalize(uv)
        uv, xy = uv[np.isfinite(xy[:, 0])], xy[np.isfinite(xy[:, 0])]
        n = len(uv)
        return CameraPoints(
            feature_id=np.concatenate([points.feature_id, self._ids.take(n)]),
            uv=np.concatenate([points.uv, uv]),
            xy=np.concatenate([points.xy, xy]),
            track_length=np.concatenate([points.track_length, np.zeros(n, dtype=np.int64)]),
            depth=np.concatenate([points.depth, np.full(n, np.nan)]),
            extra_flow=np.concatenate([points.extra_flow, np.zeros((n, 2))]),
            inlier=np.concatenate([points.inlier, np.ones(n, dtype=np.bool_)]),
        )

    def _new_corners(self, view: View, existing: FloatArray, focus: Focus) -> FloatArray:
        """New corners (M, 2) over the image, where it has few, and where something may move."""
        settings, shape = self._settings, view.image.shape
        wanted = focus_mask(shape, *focus)
        corners, response = fast_corners(view.image, settings.fast_threshold, view.mask)
        within, has = is_masked(corners, wanted), is_masked(existing, wanted)
        cell_px = -(-shape[1] // settings.fine_columns)
        distance_px = settings.min_distance_px
        even = even_spread(settings.max_features, distance_px, settings.grid_cell_px, shape)
        dense = Spread(settings.focus_distance_px, cell_px, settings.focus_per_cell)
        taken = existing
        for n_most, chosen, spread in (
            (settings.max_features - int((~has).sum()), ~within, even),
            # what covers that which was followed is followed itself, though there are enough
            (_UNLIMITED, ~within, Spread(distance_px, cell_px, 1)),
            (settings.focus_features - int(has.sum()), within, dense),
        ):
            new = choose_corners(corners[chosen], response[chosen], taken, n_most, spread, shape)
            taken = np.concatenate([taken, new])
        return taken[len(existing) :]


def no_focus() -> Focus:
    """Nothing to look closer at."""
    return np.empty((0, 2)), np.empty(0)


def no_points() -> CameraPoints:
    """None yet."""
    two, ints = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    return CameraPoints(ints, two, two, ints, np.empty(0), two, np.empty(0, dtype=np.bool_))


def is_masked(uv: FloatArray, mask: Image | None) -> BoolArray:
    """Which pixels (N, 2) lie where the mask is not zero; those outside it do not."""
    masked = np.zeros(len(uv), dtype=np.bool_)
    if mask is None:
        return masked
    height, width = mask.shape
    near = np.isfinite(uv).all(axis=1)
    u, v = np.round(uv[near]).astype(np.int64).T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    masked[np.flatnonzero(near)[inside]] = mask[v[inside], u[inside]] > 0
    return masked
