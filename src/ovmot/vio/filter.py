"""The MSCKF as the odometry source: propagate, update, marginalize; each returns a new filter."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory, keep_window, share_clone
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.physics import FRAME_JITTER
from ovmot.settings import Settings
from ovmot.types import (
    CalibrationEstimate,
    EgoEstimate,
    Health,
    ImuData,
    ImuNoise,
    PoseWindow,
)
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.integrators import INTEGRATORS
from ovmot.vio.landmarks import no_landmarks
from ovmot.vio.online_calibration import calibrated_rig, calibration_estimate, make_calibration
from ovmot.vio.propagation import Propagation, clone_pose, predicted_poses, propagate, propagate_imu
from ovmot.vio.slam_features import change_anchor
from ovmot.vio.state import (
    N_IMU,
    POSITION,
    TIME_OFFSET,
    VELOCITY,
    Clones,
    ImuState,
    State,
    marginalize_clone,
    pose_matrix,
)
from ovmot.vio.visual_update import update_with_features
from ovmot.vio.zero_velocity import zero_velocity_detected, zero_velocity_update


@dataclass(frozen=True, slots=True)
class MsckfFilter:
    """A filter that has been initialized.

    `state`: estimate and covariance; `rig`: that of the calibration files; `noise`: of the IMU;
    `stationary`: was zero velocity detected at the newest frame? `updated_ns`: stamp of the newest
    frame that an update used, None before the first one; `unmeasured_s`: for how long before the
    newest frame there was neither IMU nor frame.
    """

    state: State
    rig: StereoRig
    noise: ImuNoise
    settings: Settings
    stationary: bool = False
    updated_ns: int | None = None
    unmeasured_s: float = 0.0

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the present time offset."""
        return frame_ns + round(self.state.time_offset_s * 1e9)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before the filter can propagate to this frame."""
        return self.imu_time_ns(frame_ns)

    def predicted_motion(self, before_ns: int, frame_ns: int, imu: ImuBuffer) -> FloatArray:
        """T_now_before (4, 4) of the left camera between two frames, by the IMU from the newest
        state; raises `DatasetError` where `imu` does not reach so far."""
        state, gravity = self.state, self.settings.filter.gravity_mps2
        start_ns = state.timestamp_ns
        before, now = (max(self.imu_time_ns(stamp), start_ns) for stamp in (before_ns, frame_ns))
        samples = imu.between(start_ns, now, also_at_ns=(before,))
        T_world_imu = predicted_poses(state.imu, samples, gravity, state.calibration)
        at_before = int(np.searchsorted(samples.timestamp_ns, before))
        T_imu_cam0 = self.calibrated_rig().T_imu_cam0
        T_world_before, T_world_now = (
            T_world_imu[at_before] @ T_imu_cam0,
            T_world_imu[-1] @ T_imu_cam0,
        )
        T_now_before: FloatArray = se3.inverse(T_world_now) @ T_world_before
        return T_now_before

    def propagate(self, frame_ns: int, imu: ImuBuffer) -> "MsckfFilter":
        """Propagate to the frame and clone its pose.

        Raises `DatasetError` where `imu` does not reach the frame's time.
        """
        state, rate, unmeasured_s = self._propagated(self.imu_time_ns(frame_ns), imu)
        return replace(self, state=clone_pose(state, frame_ns, rate), unmeasured_s=unmeasured_s)

    def _propagated(self, end_ns: int, imu: ImuBuffer) -> tuple[State, FloatArray, float]:
        """The state at a time on the IMU's clock; the angular velocity (3,), rad/s, there; and the
        seconds of the way there that nothing has measured (`_unmeasured_s`)."""
        if end_ns == self.state.timestamp_ns:
            return self.state, imu.at(end_ns).gyro - self.state.imu.gyro_bias, 0.0
        # a frame is found covered by an older time offset: by its change, a part may be missing
        held_ns = round(1e9 * self.settings.imu.max_gap_s)
        samples = imu.between(self.state.timestamp_ns, end_ns, held_ns=held_ns)
        spacing_s = imu.spacing_s(samples)
        in_gap = spacing_s > self.settings.imu.max_gap_s
        unmeasured_s = _unmeasured_s(samples, spacing_s, in_gap)
        result = self._integrated(
            self.state.imu, self.state.imu_first, samples, in_gap, unmeasured_s
        )
        return propagate(self.state, result, end_ns), result.angular_velocity, unmeasured_s

    def _integrated(
        self,
        start: ImuState,
        start_first: ImuState,
        samples: ImuData,
        in_gap: BoolArray,
        unmeasured_s: float,
    ) -> Propagation:
        """The propagation of an IMU state, and of its first estimate, over an interval."""
        return propagate_imu(
            start,
            start_first,
            samples,
            self.noise,
            self.settings.filter.gravity_mps2,
            INTEGRATORS[self.settings.filter.integration],
            in_gap,
            self.state.calibration,
            unmeasured_s / np.sqrt(3.0),  # uniform from none to all
        )

    def update(
        self, table: FeatureTable, history: StereoHistory
    ) -> tuple["MsckfFilter", FeatureTable]:
        """Zero-velocity update where the rig is stationary, then the visual update."""
        state, zero_velocity = self.state, self.settings.zero_velocity
        stationary = zero_velocity.enabled and zero_velocity_detected(
            state, table, history, self.rig, zero_velocity
        )
        if stationary:
            state = zero_velocity_update(state)
        oldest_is_marginalized = self._clone_to_marginalize(stationary) == 0
        state, table = update_with_features(
            state, table, self.rig, self.settings.filter,
            oldest_is_marginalized=oldest_is_marginalized,
        )  # fmt: skip
        updated_ns = self.updated_ns
        if state.covariance is not self.state.covariance or updated_ns is None:
            updated_ns = int(state.clones.timestamp_ns[-1])
        return replace(self, state=state, stationary=stationary, updated_ns=updated_ns), table

    def marginalize(self, table: FeatureTable) -> tuple["MsckfFilter", FeatureTable]:
        """Marginalize a clone; the frames of a stationary rig share the clone that stays."""
        state, stamps = self.state, self.state.clones.timestamp_ns
        index = self._clone_to_marginalize(self.stationary)
        if index is not None:
            new_anchor = -2 if index == len(stamps) - 1 else -1
            state = change_anchor(
                state, int(stamps[index]), int(stamps[new_anchor]), self.rig.T_imu_cam0
            )
            state = marginalize_clone(state, index)
        if self.stationary and index is not None:
            table = share_clone(table, int(stamps[-1]), int(stamps[-2]))
        table = keep_window(table, state.clones.timestamp_ns)
        return replace(self, state=state), table

    def _clone_to_marginalize(self, stationary: bool) -> int | None:
        """Index of the clone that leaves after this frame, None for none.

        The newest where the rig is stationary; the one before it where its neighbours are closer
        than the spacing (the next frame is predicted from the newest); the oldest of a full window.
        """
        stamps = self.state.clones.timestamp_ns
        n, settings = len(stamps), self.settings.filter
        if stationary and n >= 2:
            return n - 1
        spacing_ns = (1.0 + FRAME_JITTER) * 1e9 * settings.clone_spacing_s
        if n >= 3 and stamps[-1] - stamps[-3] <= spacing_ns:
            return n - 2
        return 0 if n > settings.max_clones else None

    def window(self) -> PoseWindow:
        """The clones' poses and their covariance."""
        clones = self.state.clones
        return PoseWindow(clones.timestamp_ns, clones.T_world_imu, self.state.clone_covariance)

    def calibrated_rig(self) -> StereoRig:
        """The rig as it is calibrated now."""
        return calibrated_rig(self.rig, self.state.calibration)

    def health(self, frame_ns: int) -> Health:
        """How far the filter can be trusted at a frame, by its last update and its covariance."""
        limits = self.settings.health
        since_update_s = 0.0 if self.updated_ns is None else 1e-9 * (frame_ns - self.updated_ns)
        sigma = np.sqrt(self.state.covariance.diagonal()[VELOCITY].max())
        if since_update_s > limits.lost_after_s or sigma > limits.lost_velocity_sigma_mps:
            return Health.LOST
        if self.unmeasured_s > limits.lost_after_gap_s:
            return Health.LOST
        return Health.DEGRADED if since_update_s > limits.degraded_after_s else Health.TRACKING

    def placed(self, T_world_imu: FloatArray) -> "MsckfFilter":
        """The same filter, just initialized, with its first pose at this position and heading.

        `T_world_imu` (4, 4). Positions and velocities turn about the vertical; rotation errors are
        in the body frame and stay.
        """
        state = self.state
        T = state.clones.T_world_imu
        first = T[0] if len(T) else pose_matrix(state.imu)
        R = T_world_imu[:3, :3] @ first[:3, :3].T
        yaw = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        R_new_old = so3.exp(np.array([0.0, 0.0, yaw]))
        T_new_old = se3.make(R_new_old, T_world_imu[:3, 3] - R_new_old @ first[:3, 3])
        imu = replace(
            state.imu,
            R_world_imu=R_new_old @ state.imu.R_world_imu,
            position=se3.apply(T_new_old, state.imu.position),
            velocity=R_new_old @ state.imu.velocity,
        )
        G = np.eye(len(state.covariance))
        G[POSITION, POSITION] = G[VELOCITY, VELOCITY] = R_new_old
        for k in range(len(T)):
            position = slice(state.clone_columns(k).start + 3, state.clone_columns(k).stop)
            G[position, position] = R_new_old
        covariance = G @ state.covariance @ G.T
        placed = replace(
            state,
            imu=imu,
            imu_first=imu,
            clones=Clones(state.clones.timestamp_ns, T_new_old @ T, T_new_old @ T),
            covariance=0.5 * (covariance + covariance.T),
        )
        return replace(self, state=placed)

    def estimate_at(self, imu_ns: int, imu: ImuBuffer) -> EgoEstimate:
        """The state, with covariance, propagated to a time on the IMU's clock, between frames.

        Raises `DatasetError` where the IMU does not reach it.
        """
        propagated = replace(self, state=self._propagated(imu_ns, imu)[0])
        return propagated.estimate(imu_ns - round(1e9 * self.state.time_offset_s))

    def estimate(self, frame_ns: int) -> EgoEstimate:
        """The state at the newest frame, for the outputs."""
        s, P = self.state, self.state.covariance
        rig = self.calibrated_rig()
        return EgoEstimate(
            timestamp_ns=frame_ns,
            T_world_imu=pose_matrix(s.imu),
            velocity=s.imu.velocity,
            gyro_bias=s.imu.gyro_bias,
            accel_bias=s.imu.accel_bias,
            covariance=P[:N_IMU, :N_IMU],
            T_imu_cam0=rig.T_imu_cam0,
            T_imu_cam1=rig.T_imu_cam1,
            time_offset_s=s.time_offset_s,
            time_offset_std_s=float(np.sqrt(max(P[TIME_OFFSET, TIME_OFFSET], 0.0))),
            standing=self.stationary,
            health=self.health(frame_ns),
            calibration=self._calibration_estimate(),
        )

    def _calibration_estimate(self) -> CalibrationEstimate | None:
        calibration = self.state.calibration
        if not calibration.n_estimated:
            return None
        own = self.state.calibration_columns
        return calibration_estimate(self.rig, calibration, self.state.covariance[own, own])


def _unmeasured_s(samples: ImuData, spacing_s: FloatArray, in_gap: BoolArray) -> float:
    """Seconds of gaps of the IMU that lie for the greater part between two frames.

    The frames have that gap as well, and the clock may have been set: all of this time may have
    passed, or none. `spacing_s` (n,) are the distances of the samples measured around the pairs of
    `samples` (n + 1), `in_gap` (n,) the pairs in a gap.
    """
    length_s = 1e-9 * np.diff(samples.timestamp_ns)
    return float(length_s[in_gap & (length_s > 0.5 * spacing_s)].sum())


def with_online_calibration(state: State, rig: StereoRig, settings: Settings) -> State:
    """A state without clones, augmented by the online calibration, with no landmarks yet."""
    calibration, variance = make_calibration(rig, settings.calibration)
    return replace(
        state,
        calibration=calibration,
        landmarks=no_landmarks(settings.filter.landmark_representation),
        covariance=block_diag(state.covariance, np.diag(variance)),
    )
