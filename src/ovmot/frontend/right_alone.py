"""The right camera by itself, for as long as the left one has no picture."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.klt_tracker import FeatureIds, KltTracker, TrackedPoints, static_world
from ovmot.frontend.positions import carried_positions
from ovmot.frontend.prediction import motion_of_right
from ovmot.frontend.preprocessing import View
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import TrackerSettings
from ovmot.types import FrontendFrame


@dataclass(frozen=True, slots=True)
class RightView:
    """What the right camera has of a frame: its view, the frame's points (N,), their `pixels` and
    `normalized` coordinates in both images (N, 4), NaN where there is no match, and where they are
    in the left camera, `p_cam0` (N, 3), metres."""

    view: View
    points: TrackedPoints
    pixels: FloatArray
    normalized: FloatArray
    p_cam0: FloatArray

    def own_points(self) -> tuple[TrackedPoints, FloatArray]:
        """The points that are matched there as the right camera's own, and where they are in the
        left camera (M, 3)."""
        points, matched = self.points, np.flatnonzero(np.isfinite(self.pixels[:, 2]))
        own = TrackedPoints(
            feature_id=points.feature_id[matched],
            uv=self.pixels[matched, 2:],
            xy=self.normalized[matched, 2:],
            track_length=points.track_length[matched],
            depth=np.full(len(matched), np.nan),
            extra_flow=np.zeros((len(matched), 2)),
            inlier=points.inlier[matched],
            slot=points.slot[matched],
        )
        return own, self.p_cam0[matched]


class RightAlone:
    """Goes on with the features that the right camera saw last, under their ids, and new ones."""

    def __init__(self, settings: TrackerSettings, helper: Executor, ids: FeatureIds) -> None:
        self._settings, self._helper, self._ids = settings, helper, ids
        self._tracker: KltTracker | None = None
        self._p_cam1 = np.empty((0, 3))

    def end(self) -> None:
        """The left camera is back: what the right one followed by itself is given up."""
        self._tracker = None

    def track(
        self,
        timestamp_ns: int,
        view: View,
        before: RightView | None,
        T_now_before: FloatArray,
        rig: StereoRig,
        dynamic_id: IntArray,
    ) -> FrontendFrame:
        """Features of a frame, each in the right half of its columns.

        `before`: what it saw of the last frame with a left picture, None where nothing.
        `T_now_before` (4, 4): motion of the left camera since the last frame.
        """
        if self._tracker is None:
            self._tracker = KltTracker(self._settings, self._helper, self._ids)
            self._p_cam1 = np.empty((0, 3))
            if before is not None:
                points, p_cam0 = before.own_points()
                self._tracker.take_over(before.view, points)
                self._p_cam1 = se3.apply(rig.T_cam1_cam0, p_cam0)
        T, last = motion_of_right(T_now_before, rig), self._tracker.points
        points = self._tracker.step(view, static_world(self._p_cam1, T), None, dynamic_id)
        self._p_cam1 = carried_positions(last, points, self._p_cam1, T)
        unseen = np.full((len(points), 2), np.nan)
        return FrontendFrame(
            timestamp_ns=timestamp_ns,
            feature_id=points.feature_id,
            pixels=np.concatenate([unseen, points.uv], axis=1),
            normalized=np.concatenate([unseen, points.xy], axis=1),
            track_length=points.track_length,
            two_view_inlier=points.inlier,
        )
