"""Poses from a file as the odometry source, in place of the filter."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import FeatureTable, StereoHistory, empty_table, keep_window
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import GivenEgoSettings
from ovmot.types import EgoEstimate, FrontendFrame, Health, PoseWindow
from ovmot.vio.imu_buffer import ImuBuffer


@dataclass(frozen=True, slots=True)
class GivenPoses:
    """Poses of frames, given beforehand; a window of the newest takes the place of the clones.

    `pose_ns` (M,): stamps of frames, rising; `T_world_imu` (M, 4, 4). Velocity is the difference of
    the last two poses; biases are unknown, hence NaN. `window_ns`: stamps of the window's poses.
    """

    pose_ns: IntArray
    T_world_imu: FloatArray
    rig: StereoRig
    settings: GivenEgoSettings
    window_ns: tuple[int, ...] = ()

    def imu_time_ns(self, frame_ns: int) -> int:
        """The frame's own stamp: no IMU is used."""
        return frame_ns

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """No IMU is needed."""
        return None

    def predicted_motion(self, before_ns: int, frame_ns: int, imu: ImuBuffer) -> FloatArray:
        """T_now_before (4, 4) of the left camera by the given poses; raises `DatasetError` where
        one is missing."""
        for stamp in (before_ns, frame_ns):
            self._check_given(stamp)
        T_world_cam0 = self._pose(before_ns) @ self.rig.T_imu_cam0
        T_now_before: FloatArray = (
            se3.inverse(self._pose(frame_ns) @ self.rig.T_imu_cam0) @ T_world_cam0
        )
        return T_now_before

    def propagate(self, frame_ns: int, imu: ImuBuffer) -> "GivenPoses":
        """The window with this frame's pose; raises `DatasetError` where none is given."""
        self._check_given(frame_ns)
        return replace(self, window_ns=(*self.window_ns, frame_ns))

    def update(
        self, table: FeatureTable, history: StereoHistory
    ) -> tuple["GivenPoses", FeatureTable]:
        """No update: the poses are given."""
        return self, table

    def marginalize(self, table: FeatureTable) -> tuple["GivenPoses", FeatureTable]:
        """The window without its oldest pose where it is full."""
        kept = self.window_ns[-self.settings.window :]
        stamps = np.array(kept, dtype=np.int64)
        table = keep_window(table, stamps)
        return replace(self, window_ns=kept), table

    def window(self) -> PoseWindow:
        """Poses of the window; their errors are taken as independent."""
        poses = np.array([self._pose(stamp) for stamp in self.window_ns]).reshape(-1, 4, 4)
        sigma = self._sigma()
        covariance = np.diag(np.tile(sigma**2, len(poses)))
        return PoseWindow(np.array(self.window_ns, dtype=np.int64), poses, covariance)

    def calibrated_rig(self) -> StereoRig:
        """The rig as the files have it."""
        return self.rig

    def health(self, frame_ns: int) -> Health:
        """Always `TRACKING`."""
        return Health.TRACKING

    def placed(self, T_world_imu: FloatArray) -> "GivenPoses":
        """The same source: given poses have their place."""
        return self

    def estimate_at(self, imu_ns: int, imu: ImuBuffer) -> EgoEstimate:
        """The newest pose: nothing is known between the given ones."""
        return self.estimate(self.window_ns[-1])

    def estimate(self, frame_ns: int) -> EgoEstimate:
        """The pose of the newest frame, for the outputs."""
        unknown = np.full(3, np.nan)
        covariance = np.full((15, 15), np.nan)
        covariance[:6, :6] = np.diag(self._sigma() ** 2)
        return EgoEstimate(
            timestamp_ns=frame_ns,
            T_world_imu=self._pose(frame_ns),
            velocity=self._velocity(),
            gyro_bias=unknown,
            accel_bias=unknown,
            covariance=covariance,
            T_imu_cam0=self.rig.T_imu_cam0,
            T_imu_cam1=self.rig.T_imu_cam1,
            time_offset_s=self.rig.time_offset_s,
            time_offset_std_s=float("nan"),
            standing=False,
        )

    def _check_given(self, frame_ns: int) -> None:
        if frame_ns not in self.pose_ns:
            raise DatasetError(f"no pose is given for the frame at {frame_ns} ns")

    def _pose(self, stamp: int) -> FloatArray:
        pose: FloatArray = self.T_world_imu[int(np.searchsorted(self.pose_ns, stamp))]
        return pose

    def _velocity(self) -> FloatArray:
        if len(self.window_ns) < 2:
            return np.full(3, np.nan)
        before, now = self.window_ns[-2:]
        displacement = self._pose(now)[:3, 3] - self._pose(before)[:3, 3]
        velocity: FloatArray = displacement / ((now - before) * 1e-9)
        return velocity

    def _sigma(self) -> FloatArray:
        s = self.settings
        return np.repeat([s.rotation_sigma_rad, s.position_sigma_m], 3)


def imu_poses_from_cam0(T_world_cam0: FloatArray, rig: StereoRig) -> FloatArray:
    """T_world_imu (M, 4, 4) from poses T_world_cam0 (M, 4, 4) of the left camera."""
    return T_world_cam0 @ se3.inverse(rig.T_imu_cam0)


@dataclass(frozen=True, slots=True)
class GivenPosesInitializer:
    """Initializes at once, by given poses. Frames without a pose are left out of a run."""

    source: GivenPoses

    def imu_time_ns(self, frame_ns: int) -> int:
        """The frame's own stamp: no IMU is used."""
        return frame_ns

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """No IMU is needed."""
        return None

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[GivenPoses, FeatureTable]:
        """The source of the given poses, and an empty table."""
        return self.source, empty_table()
