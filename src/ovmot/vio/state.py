"""The filter's state, its error coordinates and its box-plus.

Error state, in order: IMU (rotation, position, velocity, gyro bias, accelerometer bias; 15),
calibration (time offset; 1; then the parts that are estimated), clones (rotation, position; 6 each,
oldest first), landmarks (SLAM features; 3 each, or 1). Rotation errors are on the right:
R_true = R_est · exp(δθ); everything else is additive.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.vio.landmarks import Landmarks, no_landmarks
from ovmot.vio.online_calibration import OnlineCalibration
from ovmot.vio.pose_kernel import moved_poses_compiled
from ovmot.vio.propagation_kernel import covariance_of_compiled

THETA, POSITION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
TIME_OFFSET = 15
N_IMU = 15
N_BASE = N_IMU + 1
"""Coordinates that are always there: the IMU and the time offset."""
CLONE_SIZE = 6
_NO_CALIBRATION = OnlineCalibration()
_NO_LANDMARKS = no_landmarks()


@dataclass(frozen=True, slots=True)
class ImuState:
    """Rotation (3, 3), position (3,), m, and velocity (3,), m/s, of the IMU in world; biases (3,).

    Units of the biases: rad/s and m/s².
    """

    R_world_imu: FloatArray
    position: FloatArray
    velocity: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray


@dataclass(frozen=True, slots=True)
class Clones:
    """K past poses: stamps (K,) of their frames, T_world_imu (K, 4, 4), and first estimates."""

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    T_world_imu_first: FloatArray

    def __len__(self) -> int:
        return len(self.timestamp_ns)


@dataclass(frozen=True, slots=True)
class State:
    """The whole filter: estimate, first estimates and covariance (N, N) of the error state.

    `timestamp_ns` is the estimate's time on the IMU's clock. `imu_first` holds the values at which
    the Jacobians of the next propagation start (first-estimate Jacobians, G. Huang et al., ISER
    2008). `time_offset_s`: t_imu = t_camera + offset.
    """

    timestamp_ns: int
    imu: ImuState
    imu_first: ImuState
    time_offset_s: float
    clones: Clones
    covariance: FloatArray
    calibration: OnlineCalibration = _NO_CALIBRATION
    landmarks: Landmarks = _NO_LANDMARKS

    @property
    def first_clone(self) -> int:
        """First column of the clones in the error state."""
        return N_BASE + len(self.calibration)

    @property
    def first_landmark(self) -> int:
        """First column of the landmarks in the error state."""
        return self.first_clone + CLONE_SIZE * len(self.clones)

    @property
    def calibration_columns(self) -> slice:
        """Columns of the calibration that is estimated online, without the time offset."""
        return slice(N_BASE, self.first_clone)

    @property
    def clone_covariance(self) -> FloatArray:
        """The marginal covariance (6K, 6K) of the clones."""
        window = slice(self.first_clone, self.first_landmark)
        return self.covariance[window, window]

    def clone_columns(self, index: int) -> slice:
        """Columns of clone number `index` in the error state."""
        start = self.first_clone + CLONE_SIZE * index
        return slice(start, start + CLONE_SIZE)


def no_clones() -> Clones:
    """An empty window."""
    return Clones(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), np.empty((0, 4, 4)))


def box_plus(state: State, error: FloatArray) -> State:
    """The state plus an error vector (N,): estimates change, first estimates stay."""
    clones = state.clones
    poses = np.concatenate([clones.T_world_imu, pose_matrix(state.imu)[None]])
    errors = np.empty((len(poses), CLONE_SIZE))
    errors[:-1] = error[state.first_clone : state.first_landmark].reshape(-1, CLONE_SIZE)
    errors[-1] = error[THETA.start : POSITION.stop]
    poses = moved_poses_compiled(poses, errors)
    imu = ImuState(
        R_world_imu=poses[-1, :3, :3].copy(),
        position=poses[-1, :3, 3].copy(),
        velocity=state.imu.velocity + error[VELOCITY],
        gyro_bias=state.imu.gyro_bias + error[GYRO_BIAS],
        accel_bias=state.imu.accel_bias + error[ACCEL_BIAS],
    )
    return replace(
        state,
        imu=imu,
        time_offset_s=state.time_offset_s + float(error[TIME_OFFSET]),
        clones=Clones(clones.timestamp_ns, poses[:-1], clones.T_world_imu_first),
        calibration=state.calibration.plus(error[state.calibration_columns]),
        landmarks=state.landmarks.plus(error[state.first_landmark :]),
    )


def box_minus(state: State, reference: State) -> FloatArray:
    """The error vector (N,) with box_plus(reference, error) = state; same parts in both."""

    def rotation(R: FloatArray, R_reference: FloatArray) -> FloatArray:
        return so3.log(np.swapaxes(R_reference, -1, -2) @ R)

    a, b = state.imu, reference.imu
    parts = [
        rotation(a.R_world_imu, b.R_world_imu),
        a.position - b.position,
        a.velocity - b.velocity,
        a.gyro_bias - b.gyro_bias,
        a.accel_bias - b.accel_bias,
        np.array([state.time_offset_s - reference.time_offset_s]),
        state.calibration.deviation - reference.calibration.deviation,
    ]
    A, B = state.clones.T_world_imu, reference.clones.T_world_imu
    theta = rotation(A[:, :3, :3], B[:, :3, :3])
    parts.append(np.concatenate([theta, A[:, :3, 3] - B[:, :3, 3]], axis=1).ravel())
    parts.append(state.landmarks.minus(reference.landmarks))
    return np.concatenate(parts)


def marginalize_clone(state: State, index: int) -> State:
    """The state without clone number `index`: its rows and columns of the covariance go.

    No landmark may be anchored there any more; see `slam_features.change_anchor`.
    """
    kept = np.delete(np.arange(len(state.covariance)), state.clone_columns(index))
    clones = Clones(
        np.delete(state.clones.timestamp_ns, index),
        np.delete(state.clones.T_world_imu, index, axis=0),
        np.delete(state.clones.T_world_imu_first, index, axis=0),
    )
    return replace(state, clones=clones, covariance=covariance_of_compiled(state.covariance, kept))


def marginalize_landmarks(state: State, marginalized: BoolArray) -> State:
    """The state without the `marginalized` landmarks (L,)."""
    if not marginalized.any():
        return state
    columns = state.first_landmark + np.flatnonzero(np.repeat(marginalized, state.landmarks.size))
    kept = np.delete(np.arange(len(state.covariance)), columns)
    return replace(
        state,
        landmarks=state.landmarks.rows(~marginalized),
        covariance=covariance_of_compiled(state.covariance, kept),
    )


def pose_matrix(imu: ImuState) -> FloatArray:
    """T_world_imu (4, 4) of an IMU state."""
    return se3.make(imu.R_world_imu, imu.position)
