"""The frames that an initializer uses, until it has an initial state."""

from collections import deque

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import FloatArray
from ovmot.interfaces import Initializer
from ovmot.settings import InitializationSettings
from ovmot.types import FrontendFrame
from ovmot.vio.imu_buffer import ImuBuffer, integrated_rotation

_LONGER = 1.2  # than the longest window: frames kept, so that they span it at any frame rate


class FrameBuffer:
    """Keeps the newest frames before initialization, as many as an initializer uses.

    `motion_window_s`: the length that a start in motion solves over, where it is not that of the
    settings for stereo.
    """

    def __init__(
        self,
        initializer: Initializer,
        settings: InitializationSettings,
        motion_window_s: float | None = None,
    ) -> None:
        self._initializer = initializer
        self._settings = settings
        self._motion_window_s = motion_window_s or settings.motion_window_s
        self._frames: deque[FrontendFrame] = deque()

    @property
    def frames(self) -> tuple[FrontendFrame, ...]:
        """The frames, oldest first."""
        return tuple(self._frames)

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()

    def append(self, seen: FrontendFrame, imu: ImuBuffer) -> None:
        """Add a frame; drop those beyond the window, and those older than the IMU."""
        frames, first_ns = self._frames, imu.first_ns
        frames.append(seen)
        span_ns = round(_LONGER * 1e9 * self._motion_window_s)
        while len(frames) > 1 and (
            seen.timestamp_ns - frames[0].timestamp_ns > span_ns
            or (
                first_ns is not None
                and self._initializer.imu_time_ns(frames[0].timestamp_ns) < first_ns
            )
        ):
            frames.popleft()

    @property
    def imu_needed_from_ns(self) -> int | None:
        """The oldest IMU time that the initializer may use; None before the first frame."""
        if not self._frames:
            return None
        oldest_ns = self._initializer.imu_time_ns(self._frames[0].timestamp_ns)
        return oldest_ns - round(1e9 * self._settings.window_s)


def predicted_rotation(before_ns: int, now_ns: int, imu: ImuBuffer, rig: StereoRig) -> FloatArray:
    """T_now_before (4, 4) of the left camera between two times on the IMU's clock, by the gyroscope
    alone; the identity where there is no IMU."""
    T = np.eye(4)
    try:
        samples = imu.between(before_ns, now_ns)
    except DatasetError:
        return T
    R_cam_imu = rig.T_imu_cam0[:3, :3].T
    T[:3, :3] = R_cam_imu @ integrated_rotation(samples).T @ R_cam_imu.T
    return T
