"""The stereo tracker: from one stereo frame to the next, features with ids."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend.camera_tracker import CameraPoints, CameraTracker, FeatureIds, View
from ovmot.frontend.contrast import EQUALIZERS
from ovmot.frontend.epipolar import gate_matches, without_refused
from ovmot.frontend.flow import build_pyramid, follow, recover_lost
from ovmot.frontend.patches import align, smoothed
from ovmot.frontend.prediction import fill_depths, predict_right
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.geometry.id_sets import positions
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.interfaces import Feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches

_DEFAULT_DEPTH_BASELINES = 40.0  # where nothing is known, points are taken this far away


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
        self._left = CameraTracker(settings, self._workers, FeatureIds())
        self._pairs = np.empty((0, 4))  # plane coordinates of the last frame
        self._last_ns = 0

    def close(self) -> None:
        """Stop the worker threads."""
        self._workers.shutdown()

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match tested.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame, mapping
        points of the earlier camera frame into the present one. Raises `OvmotError` for a frame
        without images.
        """
        self._rig = feedback.rig
        left, right = views(frame, self._rig, self._settings, self._workers)
        p_before = triangulate_stereo(self._pairs, self._rig.T_cam1_cam0)
        p_moved = p_before + self._moved(feedback, 1e-9 * (frame.timestamp_ns - self._last_ns))
        focus = (feedback.focus_uv, feedback.focus_radius_px)
        points = self._left.step(left, p_before, p_moved, T_now_before, focus)
        self._last_ns = frame.timestamp_ns
        pixels, self._pairs, matches = self._match_right(left, right, points)
        seen = FrontendFrame(
            frame.timestamp_ns,
            points.feature_id,
            pixels,
            self._pairs,
            points.track_length,
            points.inlier,
        )
        return seen, matches

    def _moved(self, feedback: Feedback, dt_s: float) -> FloatArray:
        """How far (N, 3) the last points went by themselves, in the camera's axes of then."""
        moved = np.zeros((len(self._left.points), 3))
        ids, velocity = feedback.moving_id, feedback.moving_velocity
        if len(ids):
            at = positions(self._left.points.feature_id, ids)
            moved[at >= 0] = velocity[at[at >= 0]] * dt_s
        return moved

    def _match_right(
        self, left: View, right: View, points: CameraPoints
    ) -> tuple[FloatArray, FloatArray, StereoMatches]:
        """Pixels and plane coordinates (N, 4), accepted right halves only, and all tested pairs."""
        default = _DEFAULT_DEPTH_BASELINES * self._rig.baseline
        depth = fill_depths(points.uv, points.depth, default)
        start = predict_right(points.xy, depth, self._rig)
        pictures = left.pyramid, right.pyramid, points.uv
        flow = follow(*pictures, start, self._settings, self._workers)
        nowhere = np.empty((0, *start.shape))
        flow = recover_lost(*pictures, flow, nowhere, start, self._settings, self._workers)
        patches = self._left.patches
        refined, _, fits = align(patches, right.smooth, flow.uv, patches.warp, self._workers)
        uv = np.where(fits[:, None], refined, flow.uv)
        ok = flow.found & right.shows(uv)
        pixels = np.concatenate([points.uv, np.where(ok[:, None], uv, np.nan)], axis=1)
        xy = right.camera.normalize(pixels[:, 2:])
        normalized = np.concatenate([points.xy, xy], axis=1)
        matches = gate_matches(
            points.feature_id[ok], pixels[ok], normalized[ok], self._rig, self._epipolar
        )
        pixels[ok] = without_refused(pixels[ok], matches)
        normalized[ok] = without_refused(normalized[ok], matches)
        return pixels, normalized, matches


def views(
    frame: StereoFrame | FeatureFrame,
    rig: StereoRig,
    settings: TrackerSettings,
    workers: ThreadPoolExecutor,
) -> tuple[View, View]:
    """Left and right view of a frame, equalised; raises `OvmotError` for one without images."""
    if isinstance(frame, FeatureFrame):
        raise OvmotError(f"frame {frame.timestamp_ns}: features where images were expected")

    def view_of(image: Image, mask: Image | None, camera: Camera) -> View:
        even = EQUALIZERS[settings.equalization](image)
        return View(even, build_pyramid(even, settings), smoothed(even), mask, camera)

    right = workers.submit(view_of, frame.right, frame.right_mask, rig.cam1)
    return view_of(frame.left, frame.left_mask, rig.cam0), right.result()
