"""How the filter starts: at rest if the rig rests, else in motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import Settings
from ovmot.errors import DatasetError
from ovmot.imu_buffer import ImuBuffer
from ovmot.msckf.ego import FilterEgo, with_estimated_parts
from ovmot.msckf.start_at_rest import StartPrior, rest_failure, start_at_rest
from ovmot.msckf.start_in_motion import CannotStart, start_in_motion
from ovmot.msckf.state import State
from ovmot.msckf.stillness import still_share
from ovmot.types import FrontendFrame, ImuData, ImuNoise, followed_pixels

_MIN_REST_FRAMES = 3
_OFFSET_SIGMAS = 4.0
_MIN_MOTION_FRAMES = 5


@dataclass(frozen=True, slots=True)
class FilterStart:
    """Looks at the frames seen so far and the IMU; gives a filter at the first of them."""

    rig: StereoRig
    noise: ImuNoise
    settings: Settings

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the calibration's time offset."""
        return frame_ns + round(self.rig.time_offset_s * 1e9)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before this frame is looked at.

        A little more than the frame's own: the filter may move the time offset while it goes
        through the frames it was started on.
        """
        return self.imu_time_ns(frame_ns) + round(
            1e9 * _OFFSET_SIGMAS * self._prior().time_offset_sigma_s
        )

    def __call__(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> FilterEgo | str:
        """A filter whose state is at the first frame's time, or why there is none yet."""
        reason = "too few frames"
        try:
            resting = self._at_rest(frames, imu)
            if isinstance(resting, State):
                return self._filter(resting)
            reason = f"not at rest: {resting}"
            window_s = self.settings.initialization.motion_window_s
            if self._span_s(frames) < window_s:
                return f"{reason}; in motion: needs {window_s:g} s of frames"
            moving = self._in_motion(frames, imu)
            return self._filter(moving)
        except (CannotStart, DatasetError, np.linalg.LinAlgError) as error:
            reason = f"{reason}; in motion: {error}"
        return reason

    def _filter(self, state: State) -> FilterEgo:
        state = with_estimated_parts(state, self.rig, self.settings)
        return FilterEgo(state, self.rig, self.noise, self.settings)

    def _at_rest(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> State | str:
        settings = self.settings.initialization
        now = self.imu_time_ns(frames[-1].timestamp_ns)
        first = imu.first_ns
        begin = now - round(1e9 * settings.window_s)
        if len(frames) < _MIN_REST_FRAMES or first is None or first > begin:
            return f"fewer than {_MIN_REST_FRAMES} frames over {settings.window_s:g} s of IMU"
        start = self.imu_time_ns(frames[0].timestamp_ns)
        samples = imu.between(min(begin, start), now)
        failure = rest_failure(samples, _share(frames, settings.rest_pixel), settings)
        if failure is not None:
            return failure
        state = start_at_rest(samples, self.noise, self._prior())
        return _at_time(state, start)

    def _in_motion(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> State:
        if len(frames) < _MIN_MOTION_FRAMES:
            raise CannotStart(f"only {len(frames)} frames (at least {_MIN_MOTION_FRAMES})")
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in frames]
        pieces: list[ImuData] = [imu.between(a, b) for a, b in pairwise(stamps)]
        return start_in_motion(frames, pieces, self.rig, self.noise, self._prior())

    def _prior(self) -> StartPrior:
        known = self.settings.filter
        return StartPrior(
            gravity=known.gravity_mps2,
            time_offset_s=self.rig.time_offset_s,
            time_offset_sigma_s=known.time_offset_sigma_s if known.estimate_time_offset else 0.0,
            accel_bias_sigma=self.settings.initialization.accel_bias_sigma_mps2,
        )

    @staticmethod
    def _span_s(frames: Sequence[FrontendFrame]) -> float:
        return (frames[-1].timestamp_ns - frames[0].timestamp_ns) * 1e-9


def _share(frames: Sequence[FrontendFrame], pixel: float) -> float:
    """Share of the features of both ends of the window that stand still in their image."""
    first, last = frames[0], frames[-1]
    _, a, b = np.intersect1d(first.feature_id, last.feature_id, return_indices=True)
    everything = np.ones(len(a), dtype=np.bool_)
    now, then = followed_pixels(last.pixels[b]), followed_pixels(first.pixels[a])
    return still_share(now, then, everything, pixel)


def _at_time(state: State, timestamp_ns: int) -> State:
    """The same resting state at another time of the rest."""
    return State(
        timestamp_ns, state.imu, state.imu_first, state.time_offset_s, state.clones,
        state.covariance,
    )  # fmt: skip
