"""A front end for features that something else has tracked: a simulation, another tracker."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import EpipolarSettings, TrackerSettings
from ovmot.errors import OvmotError
from ovmot.frontend.epipolar import gate_matches, without_refused
from ovmot.frontend.two_view import two_view_inliers
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches


class GivenFeatures:
    """Checks given features as the stereo tracker checks its own; remembers the last frame."""

    def __init__(
        self, rig: StereoRig, settings: TrackerSettings, epipolar: EpipolarSettings
    ) -> None:
        self._rig = rig
        self._threshold = settings.two_view_threshold_px / rig.cam0.fx
        self._epipolar = epipolar
        self._before: FrontendFrame | None = None

    def calibrate(self, rig: StereoRig) -> None:
        """From now on the rig is calibrated like this."""
        self._rig = rig

    def focus(self, uv: FloatArray, radius_px: FloatArray) -> None:
        """Given features are what they are."""

    def close(self) -> None:
        """Nothing to stop."""

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame with accepted right halves only, and all tested pairs.

        The prediction is not needed. Features whose left pixel the lens model does not reach are
        left out. Raises `OvmotError` for a frame of images.
        """
        if isinstance(frame, StereoFrame):
            raise OvmotError(f"frame {frame.timestamp_ns}: images where features were expected")
        xy0 = self._rig.cam0.normalize(frame.pixels[:, :2])
        known = np.isfinite(xy0).all(axis=1)
        pixels, ids = frame.pixels[known].copy(), frame.feature_id[known]
        normalized = np.concatenate([xy0[known], self._rig.cam1.normalize(pixels[:, 2:])], axis=1)
        paired = np.isfinite(pixels[:, 2])
        matches = gate_matches(
            ids[paired], pixels[paired], normalized[paired], self._rig, self._epipolar
        )
        pixels[paired] = without_refused(pixels[paired], matches)
        normalized[paired] = without_refused(normalized[paired], matches)
        self._before = self._with_history(frame.timestamp_ns, ids, pixels, normalized)
        return self._before, matches

    def _with_history(
        self, timestamp_ns: int, ids: IntArray, pixels: FloatArray, normalized: FloatArray
    ) -> FrontendFrame:
        """Hops and the two-view verdict, from the last frame's features of the same ids."""
        hops = np.zeros(len(ids), dtype=np.int64)
        inlier = np.ones(len(ids), dtype=np.bool_)
        before = self._before
        if before is not None:
            _, now, then = np.intersect1d(
                ids, before.feature_id, assume_unique=True, return_indices=True
            )
            hops[now] = before.hops[then] + 1
            inlier[now] = two_view_inliers(
                before.normalized[then, :2], normalized[now, :2], self._threshold
            )
        return FrontendFrame(timestamp_ns, ids, pixels, normalized, hops, inlier)
