"""A front end for features that something else has tracked: a simulation, another tracker.

OpenVINS has `TrackSIM` for this.
"""

from collections.abc import Callable

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend.epipolar import gate_matches, two_view_inliers
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.interfaces import Feedback
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches


def in_stereo(feature_id: IntArray, pixels: FloatArray) -> tuple[IntArray, FloatArray]:
    """Ids (N,) and pixels (N, 4) as they are."""
    return feature_id, pixels.copy()


def left_only(feature_id: IntArray, pixels: FloatArray) -> tuple[IntArray, FloatArray]:
    """Those of the left camera alone: ids (M,), pixels (M, 4) with the right half NaN."""
    seen = np.isfinite(pixels[:, 0])
    out = pixels[seen]
    out[:, 2:] = np.nan
    return feature_id[seen], out


def each_camera(feature_id: IntArray, pixels: FloatArray) -> tuple[IntArray, FloatArray]:
    """Each camera's features by themselves, ids (M,) and pixels (M, 4): id k becomes 2k in the left
    and 2k + 1 in the right."""
    left, right = pixels.copy(), pixels.copy()
    left[:, 2:] = right[:, :2] = np.nan
    ids = np.concatenate([2 * feature_id, 2 * feature_id + 1])
    both = np.concatenate([left, right])
    seen = np.isfinite(both).any(axis=1)
    return ids[seen], both[seen]


ARRANGEMENTS: dict[str, Callable[[IntArray, FloatArray], tuple[IntArray, FloatArray]]] = {
    "stereo": in_stereo,
    "left": left_only,
    "each": each_camera,
}
"""Given features by the setting `tracker.cameras`, as `frontend.FRONT_ENDS` makes its own."""


class GivenFeatures:
    """Checks given features as the stereo tracker checks its own; remembers the last frame."""

    def __init__(
        self, rig: StereoRig, settings: TrackerSettings, epipolar: EpipolarSettings
    ) -> None:
        self._rig = rig
        self._settings = settings
        self._epipolar = epipolar
        self._before: FrontendFrame | None = None

    def close(self) -> None:
        """Nothing to stop."""

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame with accepted right halves only, and all tested pairs.

        Of the prediction only the rotation is needed. Features whose pixel the camera model does
        not reach, in the camera that tracks them, are left out. Raises `OvmotError` for a frame of
        images.
        """
        if isinstance(frame, StereoFrame):
            raise OvmotError(f"frame {frame.timestamp_ns}: images where features were expected")
        self._rig = feedback.rig
        ids, pixels = ARRANGEMENTS[self._settings.cameras](frame.feature_id, frame.pixels)
        normalized = np.concatenate(
            [self._rig.cam0.normalize(pixels[:, :2]), self._rig.cam1.normalize(pixels[:, 2:])], 1
        )
        of_left = np.isfinite(pixels[:, 0])
        known = np.isfinite(np.where(of_left, normalized[:, 0], normalized[:, 2]))
        ids, pixels, normalized = ids[known], pixels[known], normalized[known]
        gated, matches = gate_matches(ids, pixels, normalized, self._rig, self._epipolar)
        self._before = self._with_history(
            frame.timestamp_ns, ids, gated.pixels, gated.normalized, T_now_before[:3, :3]
        )
        return self._before, matches

    def _with_history(
        self,
        timestamp_ns: int,
        ids: IntArray,
        pixels: FloatArray,
        normalized: FloatArray,
        R_now_before: FloatArray,
    ) -> FrontendFrame:
        """The frame with track lengths and the two-view test, by the last frame's features of the
        same ids and the left camera's rotation (3, 3) since."""
        track_length = np.zeros(len(ids), dtype=np.int64)
        inlier = np.ones(len(ids), dtype=np.bool_)
        before = self._before
        if before is not None:
            _, now, then = np.intersect1d(
                ids, before.feature_id, assume_unique=True, return_indices=True
            )
            track_length[now] = before.track_length[then] + 1
            of_left = np.isfinite(pixels[now, 0])
            R_cam1_cam0 = self._rig.T_cam1_cam0[:3, :3]
            for view, camera, own, R in (
                (slice(0, 2), self._rig.cam0, of_left, R_now_before),
                (slice(2, 4), self._rig.cam1, ~of_left, R_cam1_cam0 @ R_now_before @ R_cam1_cam0.T),
            ):
                inlier[now[own]] = two_view_inliers(
                    before.normalized[then[own], view],
                    normalized[now[own], view],
                    R,
                    self._settings.two_view_threshold_px / camera.fx,
                )
        return FrontendFrame(timestamp_ns, ids, pixels, normalized, track_length, inlier)
