"""What the pipeline asks of its parts: a front end, a source of ego motion, and a start."""

from collections.abc import Sequence
from typing import Protocol, Self

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.types import (
    EgoEstimate,
    FeatureFrame,
    FrontendFrame,
    Health,
    PoseWindow,
    StereoFrame,
    StereoMatches,
)
from ovmot.vio.imu_buffer import ImuBuffer


class FrontEnd(Protocol):
    """From one frame to the next, features with ids."""

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match that the epipolar gate tested.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame.
        """
        ...

    def calibrate(self, rig: StereoRig) -> None:
        """From now on the rig is calibrated like this."""
        ...

    def focus(self, uv: FloatArray, radius_px: FloatArray) -> None:
        """From now on, look closer around these left pixels (N, 2), within radii (N,)."""
        ...

    def expect(self, feature_id: IntArray, velocity: FloatArray) -> None:
        """These features (N,) move, with velocities (N, 3) in m/s in the left camera's axes."""
        ...

    def close(self) -> None:
        """Stop worker threads."""
        ...


class OdometrySource(Protocol):
    """A source of ego motion: the filter, or poses from a file. Each step gives a new one."""

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock."""
        ...

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that a frame must wait for, or None."""
        ...

    def predict(self, frame_ns: int, imu: ImuBuffer) -> Self:
        """Go to the frame's time and remember its pose."""
        ...

    def correct(self, table: FeatureTable) -> tuple[Self, FeatureTable]:
        """Use what was seen, but no feature that is barred or suspect."""
        ...

    def marginalize(self, table: FeatureTable) -> tuple[Self, FeatureTable]:
        """Let a pose leave the window."""
        ...

    def window(self) -> PoseWindow:
        """The poses of the window and their covariance."""
        ...

    def calibrated_rig(self) -> StereoRig:
        """The rig as it is calibrated now."""
        ...

    def estimate(self, frame_ns: int) -> EgoEstimate:
        """The state at the newest frame."""
        ...

    def estimate_at(self, imu_ns: int, imu: ImuBuffer) -> EgoEstimate:
        """The state carried to a time on the IMU's clock."""
        ...

    def health(self, frame_ns: int) -> Health:
        """How far it can be trusted at the newest frame."""
        ...

    def placed(self, T_world_imu: FloatArray) -> Self:
        """The same source, which has just started, at a given position and heading."""
        ...


class Initializer(Protocol):
    """Looks for a start in the frames seen so far."""

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock."""
        ...

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that a frame must wait for, or None."""
        ...

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[OdometrySource, FeatureTable] | str:
        """An ego source and the table of the frames that it has gone through, or why there is none.

        That is none of the frames, and the source is at the first of them; or all of them.
        """
        ...
