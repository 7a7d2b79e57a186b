"""The stereo KLT front end: left features tracked in time, each matched into the right image.

OpenVINS calls this a stereo `TrackKLT` (`use_stereo: true`).
"""

from dataclasses import replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.corners import fine_cell_px, focus_mask
from ovmot.frontend.epipolar import gate_matches, no_matches
from ovmot.frontend.epipolar_kernel import GatedPairs, pair_up_compiled
from ovmot.frontend.feature_search import Sought
from ovmot.frontend.hidden_features import REPLY_FRAMES, expected_places
from ovmot.frontend.klt_tracker import Expected, FeatureIds, KltTracker, TrackedPoints
from ovmot.frontend.pictures import LastPictures, Pictures, judge_pictures
from ovmot.frontend.positions import carried_positions
from ovmot.frontend.prediction import median_flow_px, predict_right
from ovmot.frontend.preprocessing import LEFT, RIGHT, View, preprocess
from ovmot.frontend.right_alone import RightAlone, RightView
from ovmot.frontend.right_search import RIGHT_SEARCHES, Pair
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.id_sets import positions
from ovmot.interfaces import Feedback
from ovmot.physics import PIXEL_SIGMA, ROAD_SPEED_SIGMA_MPS
from ovmot.runtime import helping_thread
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import (
    FeatureFrame,
    FrontendFrame,
    Picture,
    StereoFrame,
    StereoMatches,
    no_features,
)


class StereoTracker:
    """Tracks corners through the left images and matches each anew into the right one.

    A stereo match is made in every frame from that frame's left patch, so that left and right
    can not drift apart, and each passes the epipolar gate or loses its right half. With more than
    one of `threads`, a second one takes half of the images and of the features.
    """

    def __init__(
        self,
        rig: StereoRig,
        settings: TrackerSettings,
        epipolar: EpipolarSettings,
        threads: int = 1,
    ) -> None:
        self._rig = rig
        self._settings = settings
        self._epipolar = epipolar
        self._helper = helping_thread(threads)
        self._search_right = RIGHT_SEARCHES[settings.stereo_search]
        ids = FeatureIds()
        self._left = KltTracker(settings, self._helper, ids)
        self._right_alone = RightAlone(settings, self._helper, ids)
        self._pictures = LastPictures()
        # of the last frame with a left picture: its stamp, where its points were, left camera; the
        # motion since then; and what the right camera saw of them
        self._last_ns = 0
        self._p_cam0 = np.empty((0, 3))
        self._T_since = np.eye(4)
        self._last_right: RightView | None = None
        self._steps: tuple[tuple[int, FloatArray], ...] = ()  # stamps and motions to them, the last

    def close(self) -> None:
        """Stop the helping thread."""
        self._helper.shutdown()

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match tested.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame, mapping
        points of the earlier camera frame into the present one. Raises `OvmotError` for a frame
        without images.
        """
        self._rig = feedback.rig
        self._T_since = T_now_before @ self._T_since
        self._steps = (*self._steps[1 - REPLY_FRAMES :], (frame.timestamp_ns, T_now_before))
        pictures = self._judge(frame, T_now_before)
        fine = tuple(side for side in (LEFT, RIGHT) if pictures[side] == Picture.FINE)
        views = dict(
            zip(fine, preprocess(frame, self._rig, self._settings, self._helper, fine), strict=True)
        )
        left, right, matches = views.get(LEFT), views.get(RIGHT), no_matches()
        if left is not None:
            seen, matches = self._track_left(frame.timestamp_ns, left, right, feedback)
        elif right is not None:
            seen = self._right_alone.track(
                frame.timestamp_ns, right, self._last_right, T_now_before, self._rig,
                feedback.dynamic_id,
            )  # fmt: skip
        else:
            seen = no_features(frame.timestamp_ns)
        return replace(seen, pictures=pictures), matches

    def _judge(self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray) -> Pictures:
        """What both cameras gave; pictures are compared with the last ones where things moved."""
        flow_px = median_flow_px(self._left.points.xy, self._p_cam0, T_now_before, self._rig.cam0)
        moving = flow_px > 2.0 * PIXEL_SIGMA
        pictures, self._pictures = judge_pictures(frame, self._pictures, moving)
        return pictures

    def _track_left(
        self, timestamp_ns: int, left: View, right: View | None, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of a frame with a left picture, and the stereo matches where it has both."""
        # track the left points, from where they were in space and how they move
        last, p_before, T_now_before = self._left.points, self._p_cam0, self._T_since
        dt_s = 1e-9 * (timestamp_ns - self._last_ns)
        p_predicted = p_before + self._displacements(feedback, dt_s)
        shape, cell_px = left.image.shape, fine_cell_px(left.image.shape, self._settings)
        focus = focus_mask(shape, feedback.focus_uv, feedback.focus_radius_px, cell_px)
        # bodies are looked for by their depths of the last stereo pair
        way_m = 0.0 if self._last_right is None else ROAD_SPEED_SIGMA_MPS[0] * dt_s
        hidden = expected_places(feedback.hidden, timestamp_ns, self._steps)
        expected = Expected(p_before, p_predicted, T_now_before, way_m, hidden)
        points = self._left.step(left, expected, focus, feedback.dynamic_id)
        # match them into the right image, and gate the matches
        if right is None:
            unseen, matches = np.full((len(points), 2), np.nan), no_matches()
            pixels = np.concatenate([points.uv, unseen], axis=1)
            normalized = np.concatenate([points.xy, unseen], axis=1)
            self._p_cam0 = carried_positions(last, points, p_before, T_now_before)
        else:
            gated, matches = self._match_right(left, right, points, cell_px)
            pixels, normalized, self._p_cam0 = gated.pixels, gated.normalized, gated.p_cam0
        self._last_right = (
            None if right is None else RightView(right, points, pixels, normalized, self._p_cam0)
        )
        self._last_ns, self._T_since = timestamp_ns, np.eye(4)
        self._right_alone.end()
        seen = FrontendFrame(
            timestamp_ns=timestamp_ns,
            feature_id=points.feature_id,
            pixels=pixels,
            normalized=normalized,
            track_length=points.track_length,
            two_view_inlier=points.inlier,
        )
        return seen, matches

    def _displacements(self, feedback: Feedback, dt_s: float) -> FloatArray:
        """How far (N, 3) the last points moved on their own, metres in the camera's axes of then;
        zero for those that no object has."""
        moved = np.zeros((len(self._left.points), 3))
        ids, velocity = feedback.moving_id, feedback.moving_velocity
        if len(ids):
            at = positions(self._left.points.feature_id, ids)
            moved[at >= 0] = velocity[at[at >= 0]] * dt_s
        return moved

    def _match_right(
        self, left: View, right: View, points: TrackedPoints, cell_px: int
    ) -> tuple[GatedPairs, StereoMatches]:
        """The features, with accepted right halves only, and all tested pairs."""
        # predict the right position by the depth of the point, or of those around it; where none
        # is known, by a disparity of half a fine cell
        default = self._rig.baseline * left.camera.fx / (0.5 * cell_px)
        start = predict_right(points.uv, points.xy, points.depth, default, self._rig)
        # the patch as it is seen in the left image, sought in the right one
        sought = Sought(left.pyramid, points.uv, self._left.patches, points.slot)
        pair = Pair(left, right, points, self._rig)
        seen = self._search_right(sought, pair, start, self._settings, self._helper)
        camera = right.camera
        pixels, normalized = pair_up_compiled(
            points.uv, points.xy, seen.uv, camera.normalize(seen.uv), seen.found,
            right.compact_mask, camera.width, camera.height, right.pyramid.window // 2,
        )  # fmt: skip
        # epipolar gate on every pair
        return gate_matches(points.feature_id, pixels, normalized, self._rig, self._epipolar)
