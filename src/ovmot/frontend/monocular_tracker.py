"""The KLT front end without stereo matching: one camera, or both, each by itself.

OpenVINS calls this a monocular or binocular `TrackKLT` (`use_stereo: false`).
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.epipolar import no_matches
from ovmot.frontend.klt_tracker import FeatureIds, KltTracker, TrackedPoints, static_world
from ovmot.frontend.positions import positions_by_motion
from ovmot.frontend.prediction import motion_of_right
from ovmot.frontend.preprocessing import LEFT, preprocess
from ovmot.geometry.arrays import FloatArray
from ovmot.interfaces import Feedback
from ovmot.runtime import helping_thread
from ovmot.settings import TrackerSettings
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches


class MonocularTracker:
    """Tracks corners through the images of some cameras, each by itself, with ids of their own.

    `sides`: which cameras, of `LEFT` and `RIGHT`. A feature of the right camera has no left pixel.
    """

    def __init__(
        self,
        rig: StereoRig,
        settings: TrackerSettings,
        sides: tuple[int, ...],
        threads: int = 1,
    ) -> None:
        self._rig = rig
        self._settings = settings
        self._helper = helping_thread(threads)
        ids = FeatureIds()
        self._trackers = {side: KltTracker(settings, self._helper, ids) for side in sides}
        self._positions = {side: np.empty((0, 3)) for side in sides}

    def close(self) -> None:
        """Stop the helping thread."""
        self._helper.shutdown()

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, those of the left camera first, and no stereo match.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame. Raises
        `OvmotError` for a frame without images.
        """
        self._rig = feedback.rig
        sides = tuple(self._trackers)
        seen = preprocess(frame, self._rig, self._settings, self._helper, sides)
        views = dict(zip(sides, seen, strict=True))
        points = {}
        for side, tracker in self._trackers.items():
            T = T_now_before if side == LEFT else motion_of_right(T_now_before, self._rig)
            last = tracker.points
            expected = static_world(self._positions[side], T)
            points[side] = tracker.step(views[side], expected, None, feedback.dynamic_id)
            self._positions[side] = positions_by_motion(last, points[side], T)
        return _joined(frame.timestamp_ns, points), no_matches()


def _joined(timestamp_ns: int, points: dict[int, TrackedPoints]) -> FrontendFrame:
    """One frame of the points of all cameras, each in its half of the columns."""
    n = sum(len(p) for p in points.values())
    pixels, normalized = np.full((n, 4), np.nan), np.full((n, 4), np.nan)
    row = 0
    for side, p in points.items():
        where = (slice(row, row + len(p)), slice(2 * side, 2 * side + 2))
        pixels[where], normalized[where] = p.uv, p.xy
        row += len(p)
    parts = points.values()
    return FrontendFrame(
        timestamp_ns=timestamp_ns,
        feature_id=np.concatenate([p.feature_id for p in parts]),
        pixels=pixels,
        normalized=normalized,
        track_length=np.concatenate([p.track_length for p in parts]),
        two_view_inlier=np.concatenate([p.inlier for p in parts]),
    )
