"""The filter as a source of ego motion: predict, correct, forget, each giving a new one."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import Settings
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.imu_buffer import ImuBuffer
from ovmot.msckf import propagation
from ovmot.msckf.correction import correct_with_features
from ovmot.msckf.state import FIRST_CLONE, N_IMU, TIME_OFFSET, State, drop_clone
from ovmot.msckf.zero_velocity import is_standing, still_share, zero_velocity_update
from ovmot.tracks import TrackTable, keep_window, share_clone
from ovmot.types import EgoEstimate, ImuNoise, PoseWindow

_SPACING_SLACK = 1.05  # frames do not come to the nanosecond


@dataclass(frozen=True, slots=True)
class FilterEgo:
    """A filter that runs; `standing` is its verdict on the newest frame."""

    state: State
    rig: StereoRig
    noise: ImuNoise
    settings: Settings
    standing: bool = False

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the present time offset."""
        return frame_ns + round(self.state.time_offset_s * 1e9)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before this frame can be predicted."""
        return self.imu_time_ns(frame_ns)

    def predict(self, frame_ns: int, imu: ImuBuffer) -> "FilterEgo":
        """Propagate to the frame and clone its pose; `imu` must reach its time."""
        end_ns = self.imu_time_ns(frame_ns)
        if end_ns <= self.state.timestamp_ns:  # the frame at which the filter starts
            rate = imu.at(end_ns).gyro - self.state.imu.gyro_bias
            return replace(self, state=propagation.clone_pose(self.state, frame_ns, rate))
        samples = imu.between(self.state.timestamp_ns, end_ns)
        result = propagation.propagate_imu(
            self.state.imu,
            self.state.imu_first,
            samples,
            self.noise,
            self.settings.filter.gravity_mps2,
            propagation.INTEGRATORS[self.settings.filter.integration],
            self.settings.imu.max_gap_s,
        )
        state = propagation.propagate(self.state, result, end_ns)
        return replace(self, state=propagation.clone_pose(state, frame_ns, result.angular_velocity))

    def correct(self, table: TrackTable, moving: BoolArray) -> tuple["FilterEgo", TrackTable]:
        """Zero velocity when standing, then the visual update.

        `moving` (F,): columns of the table that are dynamic or under suspicion in this frame.
        """
        state = self.state
        standing = is_standing(
            state, _share_of_still(table, moving, self.settings), self.settings.zero_velocity
        )
        if standing:
            state = zero_velocity_update(state)
        full = len(state.clones) > self.settings.filter.max_clones
        state, table = correct_with_features(
            state, table, self.rig, self.settings.filter, moving,
            oldest_leaves=full and not standing,
        )  # fmt: skip
        return replace(self, state=state, standing=standing), table

    def forget(self, table: TrackTable) -> tuple["FilterEgo", TrackTable]:
        """Let a clone go: the newest when standing, one that is too close, or the oldest.

        Before the newest, so that the next frame can still be predicted from it.
        """
        state, stamps = self.state, self.state.clones.timestamp_ns
        spacing_ns = _SPACING_SLACK * 1e9 * self.settings.filter.clone_spacing_s
        if self.standing and len(stamps) >= 2:
            state = drop_clone(state, len(stamps) - 1)
            table = share_clone(table, int(stamps[-1]), int(stamps[-2]))
        elif len(stamps) >= 3 and stamps[-1] - stamps[-3] <= spacing_ns:
            state = drop_clone(state, len(stamps) - 2)
        elif len(stamps) > self.settings.filter.max_clones:
            state = drop_clone(state, 0)
        table = keep_window(table, state.clones.timestamp_ns)
        return replace(self, state=state), table

    def window(self) -> PoseWindow:
        """The clones' poses and their covariance."""
        clones, P = self.state.clones, self.state.covariance
        return PoseWindow(clones.timestamp_ns, clones.T_world_imu, P[FIRST_CLONE:, FIRST_CLONE:])

    def estimate(self, frame_ns: int) -> EgoEstimate:
        """The state at the newest frame, for the outputs."""
        s, P = self.state, self.state.covariance
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = s.imu.R_world_imu, s.imu.position
        return EgoEstimate(
            timestamp_ns=frame_ns,
            T_world_imu=T,
            velocity=s.imu.velocity,
            gyro_bias=s.imu.gyro_bias,
            accel_bias=s.imu.accel_bias,
            covariance=P[:N_IMU, :N_IMU],
            T_imu_cam0=self.rig.T_imu_cam0,
            T_imu_cam1=self.rig.T_imu_cam1,
            time_offset_s=s.time_offset_s,
            time_offset_std_s=float(np.sqrt(max(P[TIME_OFFSET, TIME_OFFSET], 0.0))),
            standing=self.standing,
        )


def _share_of_still(table: TrackTable, moving: BoolArray, settings: Settings) -> float:
    if table.shape[0] < 2:
        return 0.0
    now: FloatArray = table.pixels[-1, :, :2]
    return still_share(
        now, table.pixels[-2, :, :2], ~moving & ~table.barred, settings.zero_velocity.pixel
    )
