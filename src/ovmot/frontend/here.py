"""A front end that works where its answer is asked for."""

import time
from collections.abc import Callable

from ovmot.geometry.arrays import FloatArray
from ovmot.interfaces import Feedback, FrontEnd, Tracked
from ovmot.types import FeatureFrame, StereoFrame


class FrontEndHere:
    """Runs a front end in the thread that waits for its answer; raises what that raises."""

    def __init__(self, front_end: FrontEnd) -> None:
        self._front_end = front_end

    def begin(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> Callable[[], Tracked]:
        """What tracks the frame when it is called."""

        def track() -> Tracked:
            start = time.perf_counter()
            seen, matches = self._front_end.track(frame, T_now_before, feedback)
            return Tracked(seen, matches, 1e3 * (time.perf_counter() - start))

        return track

    def close(self) -> None:
        """End the front end's threads."""
        self._front_end.close()
