"""The stereo tracker: from one stereo frame to the next, features with ids."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import EpipolarSettings, TrackerSettings
from ovmot.errors import OvmotError
from ovmot.frontend.contrast import EQUALIZERS
from ovmot.frontend.corners import choose_corners, fast_corners
from ovmot.frontend.epipolar import gate_matches, without_refused
from ovmot.frontend.flow import follow
from ovmot.frontend.focus import dense_settings, focus_mask, sparse_settings
from ovmot.frontend.patches import Patches, align, cut_patches, followed, smoothed
from ovmot.frontend.prediction import fill_depths, predict_left, predict_right, unexplained_flow
from ovmot.frontend.two_view import two_view_inliers
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches

_BORDER_PX = 3.0
_UNLIMITED = 100_000
_DEFAULT_DEPTH_BASELINES = 40.0  # where nothing is known, points are taken this far away


@dataclass(frozen=True, slots=True)
class _LeftPoints:
    """N features in the present left image.

    `uv` pixels and `xy` plane coordinates (N, 2), `hops` (N,), `depth` (N,) expected in metres or
    NaN, `extra_flow` (N, 2) image motion beyond a resting point's, `inlier` (N,) of the two-view
    test.
    """

    feature_id: IntArray
    uv: FloatArray
    xy: FloatArray
    hops: IntArray
    depth: FloatArray
    extra_flow: FloatArray
    inlier: BoolArray


@dataclass(frozen=True, slots=True)
class _Memory:
    """The last frame: its equalised left image, its points, their stereo pairs (N, 4), patches."""

    left: Image
    points: _LeftPoints
    patches: Patches
    normalized: FloatArray


class StereoTracker:
    """Follows corners through the left images and matches each anew into the right one.

    A stereo match is made in every frame from that frame's left patch, so that left and right
    can not drift apart, and each passes the epipolar gate or loses its right half.
    """

    def __init__(
        self, rig: StereoRig, settings: TrackerSettings, epipolar: EpipolarSettings
    ) -> None:
        self._rig = rig
        self._settings = settings
        self._epipolar = epipolar
        self._workers = ThreadPoolExecutor(max_workers=2, thread_name_prefix="ovmot-klt")
        self._memory: _Memory | None = None
        self._next_id = 0
        self._focus = (np.empty((0, 2)), np.empty(0))

    def calibrate(self, rig: StereoRig) -> None:
        """From now on the rig is calibrated like this."""
        self._rig = rig

    def focus(self, uv: FloatArray, radius_px: FloatArray) -> None:
        """From now on, look closer around these left pixels (N, 2), within radii (N,)."""
        self._focus = (uv, radius_px)

    def close(self) -> None:
        """Stop the worker threads."""
        self._workers.shutdown()

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match tested.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame, mapping
        points of the earlier camera frame into the present one. Raises `OvmotError` for a frame
        without images.
        """
        if isinstance(frame, FeatureFrame):
            raise OvmotError(f"frame {frame.timestamp_ns}: features where images were expected")
        equalize = EQUALIZERS[self._settings.equalization]
        left, right = self._workers.map(equalize, (frame.left, frame.right))
        smooth, smooth_right = self._workers.map(smoothed, (left, right))
        points, patches = self._follow_left(left, smooth, T_now_before, frame.left_mask)
        n_followed = len(points.uv)
        points = self._add_corners(left, points, frame.left_mask)
        patches = patches.joined(cut_patches(smooth, points.uv[n_followed:]))
        pixels, normalized, matches = self._match_right(
            left, (right, smooth_right), points, patches, frame.right_mask
        )
        self._memory = _Memory(left, points, patches, normalized)
        seen = FrontendFrame(
            frame.timestamp_ns, points.feature_id, pixels, normalized, points.hops, points.inlier
        )
        return seen, matches

    def _follow_left(
        self, left: Image, smooth: Image, T_now_before: FloatArray, mask: Image | None
    ) -> tuple[_LeftPoints, Patches]:
        """The last frame's features in this left image, and their patches; those lost are gone."""
        if self._memory is None:
            return _no_points(), cut_patches(smooth, np.empty((0, 2)))
        old, before = self._memory.points, self._memory.normalized
        p_before = triangulate_stereo(before, self._rig.T_cam1_cam0)
        at_rest, depth = predict_left(old.xy, p_before, T_now_before, self._rig)
        start = at_rest + old.extra_flow
        uv, ok = follow(self._memory.left, left, old.uv, start, self._settings, self._workers)
        uv, patches = followed(self._memory.patches, smooth, uv)
        xy = self._rig.cam0.normalize(uv)
        ok &= self._rig.cam0.inside(uv, _BORDER_PX) & np.isfinite(xy[:, 0])
        ok &= ~_is_masked(uv, mask)
        threshold = self._settings.two_view_threshold_px / self._rig.cam0.fx
        inlier = two_view_inliers(old.xy[ok], xy[ok], threshold)
        points = _LeftPoints(
            feature_id=old.feature_id[ok],
            uv=uv[ok],
            xy=xy[ok],
            hops=old.hops[ok] + 1,
            depth=depth[ok],
            extra_flow=unexplained_flow(uv[ok], at_rest[ok], inlier),
            inlier=inlier,
        )
        return points, patches.rows(ok)

    def _add_corners(self, left: Image, points: _LeftPoints, mask: Image | None) -> _LeftPoints:
        """The points and as many new corners as there is room for."""
        uv = self._new_corners(left, points.uv, mask)
        xy = self._rig.cam0.normalize(uv)
        uv, xy = uv[np.isfinite(xy[:, 0])], xy[np.isfinite(xy[:, 0])]
        n = len(uv)
        new_ids = np.arange(self._next_id, self._next_id + n, dtype=np.int64)
        self._next_id += n
        return _LeftPoints(
            feature_id=np.concatenate([points.feature_id, new_ids]),
            uv=np.concatenate([points.uv, uv]),
            xy=np.concatenate([points.xy, xy]),
            hops=np.concatenate([points.hops, np.zeros(n, dtype=np.int64)]),
            depth=np.concatenate([points.depth, np.full(n, np.nan)]),
            extra_flow=np.concatenate([points.extra_flow, np.zeros((n, 2))]),
            inlier=np.concatenate([points.inlier, np.ones(n, dtype=np.bool_)]),
        )

    def _new_corners(self, left: Image, existing: FloatArray, mask: Image | None) -> FloatArray:
        """New corners (M, 2) over the image, where it has few, and where something may move."""
        settings, shape = self._settings, left.shape
        focus = focus_mask(shape, *self._focus)
        corners, response = fast_corners(left, settings.fast_threshold, mask)
        within, has = _is_masked(corners, focus), _is_masked(existing, focus)
        taken, resting = existing, int((~has).sum())
        for n_most, chosen in (
            (settings.max_features - resting, settings),
            (_UNLIMITED, sparse_settings(settings)),
        ):
            new = choose_corners(
                corners[~within], response[~within], taken,
                n_most - (len(taken) - len(existing)), chosen, shape,
            )  # fmt: skip
            taken = np.concatenate([taken, new])
        n_most = settings.focus_features - int(has.sum())
        new = choose_corners(
            corners[within], response[within], taken, n_most, dense_settings(settings), shape
        )
        return np.concatenate([taken, new])[len(existing) :]

    def _match_right(
        self, left: Image, right: tuple[Image, Image], points: _LeftPoints, patches: Patches,
        mask: Image | None,
    ) -> tuple[FloatArray, FloatArray, StereoMatches]:  # fmt: skip
        """Pixels and plane coordinates (N, 4), accepted right halves only, and all tested pairs.

        `right`: the image, and the same smoothed.
        """
        default = _DEFAULT_DEPTH_BASELINES * self._rig.baseline
        depth = fill_depths(points.uv, points.depth, default)
        start = predict_right(points.xy, depth, self._rig)
        uv, ok = follow(left, right[0], points.uv, start, self._settings, self._workers)
        refined, _, fits = align(patches, right[1], uv, patches.warp)
        uv = np.where(fits[:, None], refined, uv)
        ok &= self._rig.cam1.inside(uv, _BORDER_PX) & ~_is_masked(uv, mask)
        if self._settings.cameras == "left":
            ok[:] = False
        pixels = np.concatenate([points.uv, np.where(ok[:, None], uv, np.nan)], axis=1)
        xy = self._rig.cam1.normalize(pixels[:, 2:])
        normalized = np.concatenate([points.xy, xy], axis=1)
        matches = gate_matches(
            points.feature_id[ok], pixels[ok], normalized[ok], self._rig, self._epipolar
        )
        pixels[ok] = without_refused(pixels[ok], matches)
        normalized[ok] = without_refused(normalized[ok], matches)
        return pixels, normalized, matches


def _is_masked(uv: FloatArray, mask: Image | None) -> BoolArray:
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


def _no_points() -> _LeftPoints:
    two, ints = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    return _LeftPoints(ints, two, two, ints, np.empty(0), two, np.empty(0, dtype=np.bool_))
